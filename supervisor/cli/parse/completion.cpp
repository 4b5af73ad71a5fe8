// SPDX-License-Identifier: Apache-2.0
// Completion for shells: verbs, then options and files of the verb that was found.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

#include "supervisor/cli/parse/words.hpp"

namespace lithe::cli {
namespace {

// What may follow a verb.
struct Next {
  std::vector<std::pair<std::string, std::string>> words;  // with what they are
  bool file = false;
};

Next next_of(const CLI::App& app, const Verb& verb) {
  Next next;
  for (const Verb& each : all_verbs(*verb.app))
    if (each.name.find(' ') == std::string::npos) next.words.emplace_back(each.name, each.app->get_description());
  for (const CLI::App* from : {verb.app, &app}) {
    for (const Argument& each : arguments_of(*from)) {
      next.file = next.file || (each.flags.empty() && is_file(each));
      for (const std::string& flag : each.flags) next.words.emplace_back(flag, each.about);
    }
    if (from == &app) break;  // of `lithe` itself once
  }
  return next;
}

std::vector<Verb> with_root(const CLI::App& app) {
  std::vector<Verb> all = all_verbs(app);
  all.insert(all.begin(), {"", &app});
  return all;
}

// Every option that takes a value, for which files are a guess or not.
std::vector<std::string> value_flags(const CLI::App& app, bool files) {
  std::vector<std::string> flags;
  for (const Verb& verb : with_root(app)) {
    for (const Argument& each : arguments_of(*verb.app)) {
      if (each.type.empty() || is_file(each) != files) continue;
      flags.insert(flags.end(), each.flags.begin(), each.flags.end());
    }
  }
  std::ranges::sort(flags);
  flags.erase(std::unique(flags.begin(), flags.end()), flags.end());
  return flags;
}

// The part that both shells understand: goes over the words before the cursor, leaves the verb in $verb.
std::string find_verb(const CLI::App& app, const char* word_i, const char* first, const char* last) {
  std::string names;
  for (const Verb& each : all_verbs(app)) names += "|" + each.name;
  std::vector<std::string> takes = value_flags(app, true), plain = value_flags(app, false);
  takes.insert(takes.end(), plain.begin(), plain.end());
  return fmt::format(
      "  local verbs='{}|' verb='' i next\n"
      "  for ((i = {}; i < {}; i++)); do\n"
      "    case \"{}\" in\n"
      "      {}) ((i++)) ;;\n"
      "      -*) ;;\n"
      "      *)\n"
      "        next=\"${{verb:+$verb }}{}\"\n"
      "        if [[ \"$verbs\" == *\"|$next|\"* ]]; then verb=\"$next\"; fi ;;\n"
      "    esac\n"
      "  done\n",
      names, first, last, word_i, fmt::join(takes, "|"), word_i);
}

std::string quoted(std::string text) {
  for (std::size_t at = 0; (at = text.find('\'', at)) != std::string::npos; at += 4) text.replace(at, 1, "'\\''");
  return "'" + text + "'";
}

// "name:what it is" of zsh's _describe; a colon in the name would end it.
std::string described(const std::pair<std::string, std::string>& word) {
  return quoted(word.first + ":" + word.second);
}

}  // namespace

std::string to_bash(const CLI::App& app) {
  std::string text =
      "# bash completion of lithe, made by `lithe help --bash`\n_lithe() {\n"
      "  local word=\"${COMP_WORDS[COMP_CWORD]}\" before=\"${COMP_WORDS[COMP_CWORD - 1]}\" words='' files=''\n";
  text += find_verb(app, "${COMP_WORDS[i]}", "1", "COMP_CWORD");
  text += fmt::format(
      "  case \"$before\" in\n    {}) COMPREPLY=($(compgen -f -- \"$word\")); return ;;\n    {}) return ;;\n",
      fmt::join(value_flags(app, true), "|"), fmt::join(value_flags(app, false), "|"));
  text += "  esac\n  case \"$verb\" in\n";
  for (const Verb& verb : with_root(app)) {
    const Next next = next_of(app, verb);
    std::string words;
    for (const auto& [name, about] : next.words) words += (words.empty() ? "" : " ") + name;
    text += fmt::format("    '{}') words='{}'{} ;;\n", verb.name, words, next.file ? " files=yes" : "");
  }
  return text +
         "  esac\n  COMPREPLY=($(compgen -W \"$words\" -- \"$word\"))\n"
         "  if [[ -n \"$files\" && \"$word\" != -* ]]; then COMPREPLY+=($(compgen -f -- \"$word\")); fi\n"
         "}\ncomplete -o filenames -F _lithe lithe\n";
}

std::string to_zsh(const CLI::App& app) {
  std::string text =
      "#compdef lithe\n# zsh completion of lithe, made by `lithe help --zsh`\n_lithe() {\n  local -a list\n  local "
      "files=''\n";
  text += find_verb(app, "${words[i]}", "2", "CURRENT");
  text += fmt::format("  case \"${{words[CURRENT - 1]}}\" in\n    {}) _files; return ;;\n    {}) return ;;\n  esac\n",
                      fmt::join(value_flags(app, true), "|"), fmt::join(value_flags(app, false), "|"));
  text += "  case \"$verb\" in\n";
  for (const Verb& verb : with_root(app)) {
    const Next next = next_of(app, verb);
    std::string words;
    for (const auto& each : next.words) words += "\n        " + described(each);
    text += fmt::format("    '{}')\n      list=({}\n      ){} ;;\n", verb.name, words, next.file ? " files=yes" : "");
  }
  return text +
         "  esac\n  _describe 'lithe' list\n  if [[ -n \"$files\" ]]; then _files; fi\n}\ncompdef _lithe lithe\n";
}

}  // namespace lithe::cli
