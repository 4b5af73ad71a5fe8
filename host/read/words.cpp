// SPDX-License-Identifier: Apache-2.0
#include "host/read/words.hpp"

#include <algorithm>
#include <charconv>
#include <cstdint>
#include <sstream>

#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr int kGroupBits = 32;
constexpr std::size_t kCoresInADigit = 4;

std::string_view trimmed(std::string_view text) {
  text.remove_prefix(std::min(text.find_first_not_of(" \t"), text.size()));
  return text.substr(0, text.find_last_not_of(" \t") + 1);
}

}  // namespace

std::string field_of(const std::string& text, const std::string& name) {
  for (const std::string_view line : lines_in(text)) {
    const std::size_t colon = line.find(':');
    if (!line.starts_with(name) || colon == std::string_view::npos || trimmed(line.substr(0, colon)) != name) continue;
    return std::string(trimmed(line.substr(colon + 1)));
  }
  return "";
}

std::vector<std::string> split(std::string_view text) {
  std::vector<std::string> words;
  std::istringstream in{std::string(text)};
  for (std::string word; in >> word;) words.push_back(word);
  return words;
}

bool has_word(std::string_view text, std::string_view word) { return contains(split(text), word); }

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
  std::ranges::reverse(groups);
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
      if (!std::ranges::binary_search(cpus, static_cast<int>(first + bit))) continue;
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
