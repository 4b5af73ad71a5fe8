// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/edit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstddef>

#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"

namespace lithe::host {
namespace {

constexpr std::string_view kBlanks = " \t";

std::string place(const std::string& path, std::size_t line) { return fmt::format("{}:{}", path, line); }

// A line of extlinux.conf: "APPEND root=..." has the word "append" and an argument that begins at an offset of the
// file.
struct ExtlinuxLine {
  std::size_t number;
  std::string word;
  std::string_view argument;
  std::size_t argument_at;
};

std::vector<ExtlinuxLine> lines_of(std::string_view text) {
  std::vector<ExtlinuxLine> lines;
  for (const std::string_view line : lines_in(text)) {
    const std::size_t first = std::min(line.find_first_not_of(kBlanks), line.size());
    const std::size_t behind = std::min(line.find_first_of(kBlanks, first), line.size());
    const std::size_t argument = std::min(line.find_first_not_of(kBlanks, behind), line.size());
    std::string word(line.substr(first, behind - first));
    std::ranges::transform(word, word.begin(), [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    const auto at = static_cast<std::size_t>(line.data() - text.data());
    lines.push_back({lines.size() + 1, word, line.substr(argument), at + argument});
  }
  return lines;
}

std::string trimmed(std::string_view text) { return std::string(text.substr(0, text.find_last_not_of(kBlanks) + 1)); }

// The only line with that word, if that is so. `lines` is not empty.
Result<ExtlinuxLine> only(const std::vector<ExtlinuxLine>& lines, const std::string& path, std::string_view word) {
  const auto is_it = [&](const ExtlinuxLine& line) { return line.word == word; };
  const auto found = std::ranges::find_if(lines, is_it);
  if (found == lines.end())
    return refusal(place(path, lines.front().number), fmt::format("no line \"{} ...\" from here on", word));
  const auto again = std::find_if(found + 1, lines.end(), is_it);
  if (again == lines.end()) return *found;
  return refusal(place(path, again->number),
                 fmt::format("a second \"{}\", after that of line {}", word, found->number));
}

// The lines from the label that DEFAULT names up to the next label.
Result<std::vector<ExtlinuxLine>> default_entry(const std::vector<ExtlinuxLine>& lines, const std::string& path) {
  const Result<ExtlinuxLine> chosen = only(lines, path, "default");
  if (!chosen) return chosen.error();
  const std::string name = trimmed(chosen->argument);
  std::vector<ExtlinuxLine> entry;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (lines[i].word != "label" || trimmed(lines[i].argument) != name) continue;
    if (!entry.empty()) {
      return refusal(place(path, lines[i].number),
                     fmt::format("a second label \"{}\", after that of line {}", printable(name), entry[0].number));
    }
    const auto first = lines.begin() + static_cast<std::ptrdiff_t>(i);
    entry.assign(first,
                 std::find_if(first + 1, lines.end(), [](const ExtlinuxLine& line) { return line.word == "label"; }));
  }
  if (!entry.empty()) return entry;
  return refusal(place(path, chosen->number),
                 fmt::format("DEFAULT names the label \"{}\", and there is no such label", printable(name)));
}

}  // namespace

Error refusal(const std::string& where, const std::string& what) {
  return Error{fmt::format("{}: {}: nothing is written. Correct the file and plan again", where, what)};
}

Result<> check_boot_text(const std::string& path, std::string_view text) {
  if (text.find_first_not_of(" \t\n") == std::string_view::npos) return refusal(path, "the file is empty");
  const std::size_t bad = std::min(first_non_text(text), text.find('\r'));
  if (bad == std::string_view::npos) return done();
  const auto line =
      1 + static_cast<std::size_t>(std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(bad), '\n'));
  if (text[bad] == '\r') return refusal(place(path, line), "a line end of Windows (CR)");
  return refusal(place(path, line), fmt::format("byte 0x{:02X} is no text", static_cast<unsigned char>(text[bad])));
}

Result<Edit> edit_line(const std::string& path, const std::string& text, const std::vector<Flag>& wanted) {
  if (const Result<> good = check_boot_text(path, text); !good) return good.error();
  const std::size_t end = std::min(text.find('\n'), text.size());
  if (end + 1 < text.size()) return refusal(place(path, 2), "a second line, and this file has exactly one");
  const Result<std::string> line = with_flags(text.substr(0, end), wanted, place(path, 1));
  if (!line) return line.error();
  return Edit{.path = path, .before = text, .after = *line + text.substr(end)};
}

Result<Edit> edit_extlinux(const std::string& path, const std::string& text, const std::vector<Flag>& wanted) {
  if (const Result<> good = check_boot_text(path, text); !good) return good.error();
  const Result<std::vector<ExtlinuxLine>> entry = default_entry(lines_of(text), path);
  if (!entry) return entry.error();
  const Result<ExtlinuxLine> append = only(*entry, path, "append");
  if (!append) return append.error();
  const Result<std::string> line = with_flags(append->argument, wanted, place(path, append->number));
  if (!line) return line.error();
  std::string after = text;
  after.replace(append->argument_at, append->argument.size(), *line);
  return Edit{.path = path, .before = text, .after = after};
}

namespace {

constexpr std::size_t kMostLineBytes = 2047;  // COMMAND_LINE_SIZE of x86 and arm64 is 2048, with the zero at its end

std::string without_quotes(std::string_view text) {
  std::string plain(text);
  std::erase(plain, '"');
  return plain;
}

Error conflict(const Word& there, const Flag& flag) {
  return Error{
      fmt::format("{}: \"{}\" is set there, and this plan needs \"{}\": nothing is written. Keep one: remove what is "
                  "there and plan again (`lithe tune revert` removes it if an earlier plan wrote it)",
                  there.where, printable(there.text), flag.text())};
}

}  // namespace

std::string text_of(const std::vector<Flag>& flags) { return joined(flags, &Flag::text, " "); }

std::string Word::name() const {
  std::string name = text.substr(0, text.find('='));
  std::ranges::replace(name, '-', '_');
  return name;
}

Result<std::vector<Word>> words_of(std::string_view line, const std::string& where) {
  std::vector<Word> words;
  for (std::size_t at = 0; at < line.size();) {
    if (is_blank(line[at])) {
      ++at;
      continue;
    }
    const std::size_t begin = at;
    bool quoted = false;
    for (; at < line.size() && (quoted || !is_blank(line[at])); ++at) quoted ^= line[at] == '"';
    if (quoted) {
      return Error{
          fmt::format("{}: a double quote opens at column {} or later and does not close: nothing is written. Correct "
                      "the line and plan again",
                      where, begin + 1)};
    }
    const std::string_view text = line.substr(begin, at - begin);
    if (text == "--") break;
    words.push_back({.text = without_quotes(text), .where = where, .begin = begin, .end = at});
  }
  return words;
}

Result<std::vector<Flag>> missing_flags(const std::vector<Word>& words, const std::vector<Flag>& wanted) {
  std::vector<Flag> missing;
  const Word* there = nullptr;  // a flag that isolates, and stands there
  for (const Flag& flag : wanted) {
    const auto is_it = [&](const Word& word) { return word.name() == flag.name; };
    const auto found = std::ranges::find_if(words, is_it);
    if (found == words.end()) {
      missing.push_back(flag);
      continue;
    }
    if (found->text.substr(found->name().size()) != flag.text().substr(flag.name.size())) return conflict(*found, flag);
    if (const auto again = std::find_if(found + 1, words.end(), is_it); again != words.end()) {
      return Error{fmt::format("{}: \"{}\" stands twice (first at {}): nothing is written. Remove one and plan again",
                               again->where, printable(again->text), found->where)};
    }
    if (flag.isolates) there = &*found;
  }
  const auto gone = std::ranges::find_if(missing, [](const Flag& flag) { return flag.isolates; });
  if (there != nullptr && gone != missing.end()) {
    return Error{fmt::format(
        "{}: half of an isolation: \"{}\" stands there, \"{}\" does not: nothing is written. Add what is missing or "
        "remove what is there (`lithe tune revert` does if an earlier plan wrote it), and plan again",
        there->where, printable(there->text), gone->text())};
  }
  return missing;
}

Result<std::string> with_flags(std::string_view line, const std::vector<Flag>& wanted, const std::string& where) {
  const Result<std::vector<Word>> words = words_of(line, where);
  if (!words) return words.error();
  if (words->empty()) {
    return Error{
        fmt::format("{}: no word for the kernel stands there, not even \"root=\": nothing is written. Restore the file "
                    "and plan again",
                    where)};
  }
  const Result<std::vector<Flag>> missing = missing_flags(*words, wanted);
  if (!missing) return missing.error();
  std::string whole(line);
  if (!missing->empty()) whole.insert(words->back().end, " " + text_of(*missing));
  if (whole.size() > kMostLineBytes) {
    return Error{
        fmt::format("{}: the line would have {} bytes, and kernels read {}: nothing is written. Remove flags that are "
                    "not needed and plan again",
                    where, whole.size(), kMostLineBytes)};
  }
  return whole;
}

}  // namespace lithe::host
