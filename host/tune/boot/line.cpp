// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/line.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "spine/core/text.hpp"

namespace lithe::host {
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

std::string text_of(const std::vector<Flag>& flags) {
  std::string text;
  for (const Flag& flag : flags) text += (text.empty() ? "" : " ") + flag.text();
  return text;
}

std::string Word::name() const {
  std::string name = text.substr(0, text.find('='));
  std::replace(name.begin(), name.end(), '-', '_');
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
          fmt::format("{}: a double quote opens at column {} or later and does not close: nothing is written. "
                      "Correct the line and plan again",
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
    const auto found = std::find_if(words.begin(), words.end(), is_it);
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
  const auto gone = std::find_if(missing.begin(), missing.end(), [](const Flag& flag) { return flag.isolates; });
  if (there != nullptr && gone != missing.end()) {
    return Error{
        fmt::format("{}: half of an isolation: \"{}\" stands there, \"{}\" does not: nothing is written. Add what is "
                    "missing or remove what is there (`lithe tune revert` does if an earlier plan wrote it), and plan "
                    "again",
                    there->where, printable(there->text), gone->text())};
  }
  return missing;
}

Result<std::string> with_flags(std::string_view line, const std::vector<Flag>& wanted, const std::string& where) {
  const Result<std::vector<Word>> words = words_of(line, where);
  if (!words) return words.error();
  if (words->empty()) {
    return Error{
        fmt::format("{}: no word for the kernel stands there, not even \"root=\": nothing is written. Restore "
                    "the file and plan again",
                    where)};
  }
  const Result<std::vector<Flag>> missing = missing_flags(*words, wanted);
  if (!missing) return missing.error();
  std::string whole(line);
  if (!missing->empty()) whole.insert(words->back().end, " " + text_of(*missing));
  if (whole.size() > kMostLineBytes) {
    return Error{
        fmt::format("{}: the line would have {} bytes, and kernels read {}: nothing is written. Remove flags "
                    "that are not needed and plan again",
                    where, whole.size(), kMostLineBytes)};
  }
  return whole;
}

}  // namespace lithe::host
