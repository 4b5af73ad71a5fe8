// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/edit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstddef>

#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr std::string_view kOurs = "# lithe tune";
constexpr std::string_view kFirst = "# lithe tune: isolated cores; `lithe tune revert` removes these lines";
constexpr std::string_view kLast = "# lithe tune: end";
constexpr std::string_view kVariable = "GRUB_CMDLINE_LINUX";
constexpr std::string_view kNormalOnly = "GRUB_CMDLINE_LINUX_DEFAULT";  // not for recovery

bool is_name(char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; }

std::string our_lines(const std::vector<Flag>& flags) {
  if (flags.empty()) return "";
  return fmt::format("{}\n{}=\"${} {}\"\n{}\n", kFirst, kVariable, kVariable, text_of(flags), kLast);
}

// One file, read.
struct Parsed {
  std::vector<Word> words;     // of the user's lines
  std::string ours;            // our lines, whole; empty: none
  std::size_t our_line = 0;    // where they begin; 0: none
  std::size_t dropped_at = 0;  // the last line that sets the variable anew, without its old value; 0: none
};

// "$NAME" or "${NAME}" stands in the value.
bool keeps_old(std::string_view value) {
  if (value.find(fmt::format("${{{}}}", kVariable)) != std::string_view::npos) return true;
  const std::string plain = fmt::format("${}", kVariable);
  for (std::size_t at = value.find(plain); at != std::string_view::npos; at = value.find(plain, at + 1))
    if (at + plain.size() == value.size() || !is_name(value[at + plain.size()])) return true;
  return false;
}

Result<> read_line(std::string_view line, const std::string& where, std::size_t number, Parsed& parsed) {
  const ShellLine shell = read_shell_line(line);
  if (!shell.is_whole)
    return refusal(where, "a quote does not close on this line, or the line goes on in the next one");
  if (shell.variable != kVariable && shell.variable != kNormalOnly) return done();
  const Result<std::vector<Word>> words = words_of(shell.value, where);
  if (!words) return words.error();
  parsed.words.insert(parsed.words.end(), words->begin(), words->end());
  if (shell.variable == kVariable && !keeps_old(shell.value)) parsed.dropped_at = number;
  return done();
}

Result<Parsed> parse(const GrubFile& file) {
  Parsed parsed;
  if (const Result<> good = check_boot_text(file.path, file.text); !good) return good.error();
  bool within = false;
  std::size_t number = 0;
  for (const std::string_view line : lines_in(file.text)) {
    const std::string where = fmt::format("{}:{}", file.path, ++number);
    if (line.starts_with(kOurs)) {
      const bool expected = within ? line == kLast : line == kFirst && parsed.our_line == 0;
      if (!expected) return refusal(where, "a line of ours that is not whole, or not in its place");
      if (!within) parsed.our_line = number;
      within = !within;
      parsed.ours += fmt::format("{}\n", line);
    } else if (within) {
      parsed.ours += fmt::format("{}\n", line);
    } else if (const Result<> read = read_line(line, where, number, parsed); !read) {
      return read.error();
    }
  }
  if (within) return refusal(fmt::format("{}:{}", file.path, parsed.our_line), "our lines begin here and do not end");
  return parsed;
}

// All files together.
struct Found {
  std::vector<Word> words;
  std::string ours;   // our lines, in whichever file
  std::string where;  // of them; empty: none
};

Result<Found> read_all(const std::vector<GrubFile>& files, bool has_folder) {
  Found found;
  for (const GrubFile& file : files) {
    const bool may_be_empty = &file != &files.front() && file.path != kOurGrubFile;
    if (may_be_empty && file.text.find_first_not_of(" \t\n") == std::string::npos) continue;
    const Result<Parsed> parsed = parse(file);
    if (!parsed) return parsed.error();
    found.words.insert(found.words.end(), parsed->words.begin(), parsed->words.end());
    // Our lines stand, or will stand, in front of this line.
    const bool behind = found.where.empty() ? has_folder && file.path > kOurGrubFile : true;
    const bool after_ours = behind || (parsed->our_line != 0 && parsed->dropped_at > parsed->our_line);
    if (parsed->dropped_at != 0 && after_ours) {
      return refusal(fmt::format("{}:{}", file.path, parsed->dropped_at),
                     fmt::format("this line drops what {} was before, our flags with it; write {}=\"${} ...\"",
                                 kVariable, kVariable, kVariable));
    }
    if (parsed->our_line == 0) continue;
    const std::string where = fmt::format("{}:{}", file.path, parsed->our_line);
    if (!found.where.empty()) return refusal(where, "our lines stand here and at " + found.where);
    if (file.path == kOurGrubFile && parsed->ours != file.text) return refusal(where, "other lines in our own file");
    found.ours = parsed->ours;
    found.where = where;
  }
  return found;
}

// Reads the value of an assignment, or the rest of another line, up to the end or a comment.
void read_rest(std::string_view rest, bool is_value, ShellLine& line) {
  char quote = 0;
  bool collects = is_value;
  bool word_starts = !is_value;
  for (std::size_t i = 0; i < rest.size(); ++i) {
    const char c = rest[i];
    if (c == '\\' && quote != '\'') {
      if (++i == rest.size()) line.is_whole = false;
      if (i < rest.size() && collects) {
        if (quote == '"' && std::string_view("$`\"\\").find(rest[i]) == std::string_view::npos) line.value += '\\';
        line.value += rest[i];
      }
      word_starts = false;
      continue;
    }
    const bool toggles = quote == 0 ? c == '"' || c == '\'' : c == quote;
    if (quote == 0 && c == '#' && word_starts) return;
    word_starts = quote == 0 && (is_blank(c) || c == ';' || c == '&' || c == '|' || c == '(');
    if (word_starts) collects = false;
    if (toggles)
      quote = quote == 0 ? c : '\0';
    else if (collects)
      line.value += c;
  }
  if (quote != 0) line.is_whole = false;
}

}  // namespace

ShellLine read_shell_line(std::string_view line) {
  ShellLine result;
  line.remove_prefix(std::min(line.find_first_not_of(" \t"), line.size()));
  if (line.starts_with("export ")) line.remove_prefix(std::min(line.find_first_not_of(" \t", 7), line.size()));
  const std::size_t equals = line.find('=');
  const bool assigns = equals != std::string_view::npos && equals > 0 &&
                       std::all_of(line.begin(), line.begin() + static_cast<std::ptrdiff_t>(equals), is_name);
  if (assigns) {
    result.variable = line.substr(0, equals);
    line.remove_prefix(equals + 1);
  }
  read_rest(line, assigns, result);
  return result;
}

Result<Edit> edit_grub(const std::vector<GrubFile>& files, bool has_folder, const std::vector<Flag>& wanted) {
  const Result<Found> found = read_all(files, has_folder);
  if (!found) return found.error();
  const Result<std::vector<Flag>> missing = missing_flags(found->words, wanted);
  if (!missing) return missing.error();
  const std::string lines = our_lines(*missing);
  const GrubFile& main = files.front();
  if (!found->where.empty() && found->ours != lines) {
    return Error{
        fmt::format("{}: our lines are not those of this plan, which has \"{}\": nothing is written. Run `lithe tune "
                    "revert`, or remove them, and plan again",
                    found->where, text_of(*missing))};
  }
  if (found->ours == lines) return Edit{.path = main.path, .before = main.text, .after = main.text};
  if (has_folder) return Edit{.path = kOurGrubFile, .was_absent = true, .before = "", .after = lines};
  const std::string end = main.text.ends_with('\n') ? "" : "\n";
  return Edit{.path = main.path, .before = main.text, .after = main.text + end + lines};
}

}  // namespace lithe::host
