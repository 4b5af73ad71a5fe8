// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/parse/words.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <set>
#include <string_view>

#include "spine/core/lookup.hpp"
#include "spine/robot/read/report.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::cli {
namespace {

std::vector<const CLI::App*> children(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App*) { return true; });
}

const CLI::App* child(const CLI::App& app, const std::string& name) {
  for (const CLI::App* each : children(app))
    if (each->get_name() == name) return each;
  return nullptr;
}

// The option of this app that takes the next word as its value.
bool takes_value(const CLI::App& app, const std::string& word) {
  const auto options = app.get_options([&word](const CLI::Option* each) { return each->check_name(word); });
  return !options.empty() && options.front()->get_expected_min() > 0;
}

// Follows the verbs of a command line: the last known verb, its full name, and the first unknown word.
struct Walk {
  const CLI::App* at;
  std::string name;     // " law check"
  std::string unknown;  // the first unknown verb, or option before the first verb; empty = all are known
};

Walk walk(const CLI::App& app, const std::vector<std::string>& words) {
  Walk found{&app, "", ""};
  for (std::size_t i = 0; i < words.size() && !children(*found.at).empty(); ++i) {
    const std::string& word = words[i];
    if (word.starts_with("-")) {
      const std::string name = word.substr(0, word.find('='));
      if (found.at == &app && app.get_option_no_throw(name) == nullptr) {
        found.unknown = word;
        break;
      }
      i += takes_value(app, word) ? 1 : 0;
      continue;
    }
    const CLI::App* next = child(*found.at, word);
    if (next == nullptr) {
      found.unknown = word;
      break;
    }
    found.at = next;
    found.name += " " + word;
  }
  return found;
}

control::Refusal no_such_verb(const Walk& found) {
  if (found.unknown.starts_with("-"))
    return {"usage", fmt::format("lithe has no option '{}' before its verb", found.unknown), "all of them: lithe help"};
  std::vector<std::string_view> names;
  std::vector<std::string> owned;
  for (const CLI::App* each : children(*found.at)) owned.push_back(each->get_name());
  names.assign(owned.begin(), owned.end());
  return {"unknown_verb",
          fmt::format("lithe{} has no verb '{}'{}", found.name, found.unknown, robot::suggestion(found.unknown, names)),
          "all verbs: lithe help" + found.name};
}

// The first option that neither this verb nor lithe has, with the nearest of the verb's own.
std::optional<control::Refusal> no_such_option(const CLI::App& app, const Walk& found,
                                               const std::vector<std::string>& words) {
  if (found.at == &app || found.at->get_allow_extras() || found.at->get_prefix_command()) return std::nullopt;
  std::vector<std::string> own;
  for (const CLI::Option* each : found.at->get_options())
    for (const std::string& name : each->get_lnames()) own.push_back("--" + name);
  for (const std::string& word : words) {
    const std::string name = word.substr(0, word.find('='));
    if (name == "--") break;
    const bool known = found.at->get_option_no_throw(name) != nullptr || app.get_option_no_throw(name) != nullptr;
    if (!name.starts_with("--") || known) continue;
    return control::Refusal{"usage",
                            fmt::format("lithe{} has no option '{}'{}", found.name, name,
                                        robot::suggestion(name, {own.begin(), own.end()})),
                            "see how it is written: lithe help" + found.name};
  }
  return std::nullopt;
}

// "lithe swap [options] LAW".
std::string usage_of(const Verb& verb) {
  std::string line = "lithe" + (verb.name.empty() ? "" : " " + verb.name);
  const std::vector<Argument> all = arguments_of(*verb.app);
  if (std::ranges::any_of(all, [](const Argument& each) { return !each.flags.empty(); })) line += " [options]";
  if (!children(*verb.app).empty()) line += " VERB";
  for (const Argument& each : all)
    if (each.flags.empty()) line += each.required ? " " + each.words : " [" + each.words + "]";
  return line;
}

std::string replaced(std::string text, const std::vector<std::pair<std::string_view, std::string_view>>& what) {
  for (const auto& [from, to] : what)
    for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
      text.replace(at, from.size(), to);
  return text;
}

std::string to_markdown(const CLI::App& app) {
  std::string text =
      "# The command line\n\nMade by `lithe help --markdown` from the table that parses; a test compares.\n";
  std::string group;
  const auto table = [](const CLI::App& verb) {
    const std::vector<Argument> all = arguments_of(verb);
    std::string rows = all.empty() ? "" : "\n| word | meaning |\n|---|---|\n";
    for (const Argument& each : all)
      rows += fmt::format("| `{}` | {} |\n", each.words, replaced(each.about, {{"|", "\\|"}}));
    return rows;
  };
  text += "\n    " + usage_of({"", &app}) + "\n" + table(app) + "\n" + app.get_footer() + "\n";
  for (const Verb& verb : all_verbs(app)) {
    const std::string heading = verb.app->get_parent() == &app ? verb.app->get_group() : group;
    if (heading != group) text += fmt::format("\n## {}\n", group = heading);
    text += fmt::format("\n### `{}`\n{}\n{}", usage_of(verb), verb.app->get_description(), table(*verb.app));
  }
  return text;
}

std::string troff(const std::string& text) {
  const std::string safe = replaced(text, {{"\\", "\\e"}, {"-", "\\-"}});
  return (safe.starts_with(".") || safe.starts_with("'") ? "\\&" : "") + safe;
}

std::string to_man(const CLI::App& app) {
  std::string text = fmt::format(".TH LITHE 1 \"\" \"lithe {}\" \"LITHE\"\n.SH NAME\nlithe \\- {}\n", LITHE_VERSION,
                                 troff(app.get_description()));
  const auto list = [](const CLI::App& verb) {
    std::string rows;
    for (const Argument& each : arguments_of(verb))
      rows += fmt::format(".RS\n.TP\n.B {}\n{}\n.RE\n", troff(each.words), troff(each.about));
    return rows;
  };
  text += ".SH SYNOPSIS\n.B " + troff(usage_of({"", &app})) + "\n.SH OPTIONS\n" + list(app) + ".SH VERBS\n";
  for (const Verb& verb : all_verbs(app))
    text += fmt::format(".SS {}\n{}\n{}", troff(usage_of(verb)), troff(verb.app->get_description()), list(*verb.app));
  return text + ".SH EXIT STATUS\n" + troff(app.get_footer()) + "\n";
}

}  // namespace

std::string version_text() { return fmt::format("lithe {}, layout {:016x}", LITHE_VERSION, wire::kLayoutHash); }

std::vector<Verb> all_verbs(const CLI::App& app) {
  std::vector<Verb> all;
  for (const CLI::App* each : children(app)) {
    all.push_back({each->get_name(), each});
    for (const Verb& below : all_verbs(*each)) all.push_back({each->get_name() + " " + below.name, below.app});
  }
  return all;
}

std::vector<Argument> arguments_of(const CLI::App& verb) {
  std::vector<Argument> all;
  for (const bool positional : {true, false}) {
    for (const CLI::Option* each : verb.get_options([](const CLI::Option*) { return true; })) {
      if (each->get_positional() != positional) continue;
      Argument argument;
      for (const std::string& name : each->get_lnames()) argument.flags.push_back("--" + name);
      for (const std::string& name : each->get_snames()) argument.flags.push_back("-" + name);
      const std::string type = each->get_type_name();  // the checks add text after a colon
      if (each->get_expected_min() > 0)
        argument.type = positional ? each->get_name(true) : type.substr(0, type.find(':'));
      argument.words = positional ? argument.type : fmt::format("{}", fmt::join(argument.flags, ", "));
      if (!positional && !argument.type.empty()) argument.words += " " + argument.type;
      argument.about = each->get_description();
      argument.required = each->get_required();
      all.push_back(argument);
    }
  }
  return all;
}

bool is_file(const Argument& argument) {
  static const std::set<std::string> files = {"ROBOT", "LAW", "FILE", "DIR", "WHAT"};
  return files.count(argument.type) != 0;
}

std::variant<std::string, control::Refusal> help_text(const CLI::App& app, const std::vector<std::string>& verb,
                                                      const std::string& form) {
  if (form == "markdown") return to_markdown(app);
  if (form == "man") return to_man(app);
  if (form == "bash") return to_bash(app);
  if (form == "zsh") return to_zsh(app);
  const Walk found = walk(app, verb);
  if (!found.unknown.empty()) return no_such_verb(found);
  // Not App::help(): it would describe the parsed verb, which is `help`.
  return found.at->get_formatter()->make_help(found.at, "lithe" + found.name, CLI::AppFormatMode::Normal);
}

std::optional<control::Refusal> wrong_verb(const CLI::App& app, const std::vector<std::string>& words) {
  const Walk found = walk(app, words);
  return found.unknown.empty() ? no_such_option(app, found, words) : std::optional(no_such_verb(found));
}

std::string verb_of(const CLI::App& app, const std::vector<std::string>& words) { return walk(app, words).name; }

bool asks_for_json(const std::vector<std::string>& words) { return contains(words, "--json"); }

}  // namespace lithe::cli
