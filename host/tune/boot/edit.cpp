// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/edit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstddef>

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
  std::size_t number = 0;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    const std::string_view line = text.substr(at, end - at);
    const std::size_t first = std::min(line.find_first_not_of(kBlanks), line.size());
    const std::size_t behind = std::min(line.find_first_of(kBlanks, first), line.size());
    const std::size_t argument = std::min(line.find_first_not_of(kBlanks, behind), line.size());
    std::string word(line.substr(first, behind - first));
    std::transform(word.begin(), word.end(), word.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    lines.push_back({++number, word, line.substr(argument), at + argument});
    at = end + 1;
  }
  return lines;
}

std::string trimmed(std::string_view text) { return std::string(text.substr(0, text.find_last_not_of(kBlanks) + 1)); }

// The only line with that word, if that is so. `lines` is not empty.
Result<ExtlinuxLine> only(const std::vector<ExtlinuxLine>& lines, const std::string& path, std::string_view word) {
  const auto is_it = [&](const ExtlinuxLine& line) { return line.word == word; };
  const auto found = std::find_if(lines.begin(), lines.end(), is_it);
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

}  // namespace lithe::host
