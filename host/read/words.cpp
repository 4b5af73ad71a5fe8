// SPDX-License-Identifier: Apache-2.0
#include "host/read/words.hpp"

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <sstream>

namespace lithe::host {
namespace {

constexpr int kGroupBits = 32;
constexpr std::size_t kCoresInADigit = 4;

}  // namespace

std::string field_of(const std::string& text, const std::string& name) {
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t colon = line.find(':');
    if (colon == std::string::npos) continue;
    std::string key = line.substr(0, colon);
    key.erase(key.find_last_not_of(" \t") + 1);
    if (key != name) continue;
    std::string value = line.substr(colon + 1);
    value.erase(0, value.find_first_not_of(" \t"));
    value.erase(value.find_last_not_of(" \t") + 1);
    return value;
  }
  return "";
}

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> words;
  std::istringstream in(text);
  for (std::string word; in >> word;) words.push_back(word);
  return words;
}

bool has_word(const std::string& text, const std::string& word) {
  const std::vector<std::string> words = split(text);
  return std::find(words.begin(), words.end(), word) != words.end();
}

std::string chosen(const std::string& text) {
  const std::size_t open = text.find('['), close = text.find(']');
  if (open == std::string::npos || close == std::string::npos || close < open) return "";
  return text.substr(open + 1, close - open - 1);
}

std::string value_in_force(const std::string& text) {
  const std::string marked = chosen(text);
  return marked.empty() ? text : marked;
}

std::optional<std::vector<int>> parse_mask(const std::string& text) {
  std::vector<std::uint32_t> groups;
  std::istringstream in(text);
  for (std::string part; std::getline(in, part, ',');) {
    std::uint32_t bits = 0;
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), bits, 16);
    if (error != std::errc() || end != part.data() + part.size()) return std::nullopt;
    groups.push_back(bits);
  }
  if (groups.empty() || text.ends_with(',')) return std::nullopt;
  std::vector<int> cpus;
  std::reverse(groups.begin(), groups.end());
  for (std::size_t group = 0; group < groups.size(); ++group) {
    for (int bit = 0; bit < kGroupBits; ++bit)
      if ((groups[group] >> bit & 1U) != 0) cpus.push_back(static_cast<int>(group) * kGroupBits + bit);
  }
  return cpus;
}

std::string mask_of(const std::vector<int>& cpus, const std::string& like) {
  std::string mask = like;
  std::size_t first = 0, fitted = 0;
  for (std::size_t i = mask.size(); i-- > 0;) {
    if (mask[i] == ',') continue;
    std::size_t digit = 0;
    for (std::size_t bit = 0; bit < kCoresInADigit; ++bit) {
      if (!std::binary_search(cpus.begin(), cpus.end(), static_cast<int>(first + bit))) continue;
      digit |= std::size_t{1} << bit;
      ++fitted;
    }
    mask[i] = "0123456789abcdef"[digit];
    first += kCoresInADigit;
  }
  return fitted == cpus.size() ? mask : "";
}

std::string mask_of(const std::vector<int>& cpus) {
  std::string wide = "00000000";
  for (int fits = kGroupBits; !cpus.empty() && fits <= cpus.back(); fits += kGroupBits) wide += ",00000000";
  const std::string mask = mask_of(cpus, wide);
  return mask.substr(std::min(mask.find_first_not_of('0'), mask.size() - 1));
}

}  // namespace lithe::host
