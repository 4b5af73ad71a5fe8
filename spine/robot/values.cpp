// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/values.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <map>

namespace lithe::robot {
namespace {

constexpr std::size_t kMostKeys = 12;

std::map<std::string_view, std::string_view> by_key(std::string_view values) {
  std::map<std::string_view, std::string_view> all;
  while (!values.empty()) {
    const std::string_view line = values.substr(0, values.find('\n'));
    values.remove_prefix(std::min(line.size() + 1, values.size()));
    const std::size_t sign = line.find(" = ");
    if (sign != std::string_view::npos) all[line.substr(0, sign)] = line.substr(sign + 3);
  }
  return all;
}

}  // namespace

std::uint64_t values_hash(std::string_view values) {
  constexpr std::uint64_t kBasis = 0xcbf29ce484222325U, kPrime = 0x100000001b3U;
  std::uint64_t hash = kBasis;
  for (const char each : values) hash = (hash ^ static_cast<unsigned char>(each)) * kPrime;
  return hash;
}

std::string values_difference(std::string_view here, std::string_view there) {
  const auto ours = by_key(here);
  auto theirs = by_key(there);
  std::string text;
  std::size_t count = 0;
  const auto differs = [&](std::string_view key, std::string_view mine, std::string_view other) {
    if (++count <= kMostKeys) text += fmt::format("  {} = {}, and there {}\n", key, mine, other);
  };
  for (const auto& [key, mine] : ours) {
    const auto other = theirs.extract(key);
    if (other.empty())
      differs(key, mine, "absent");
    else if (other.mapped() != mine)
      differs(key, mine, other.mapped());
  }
  for (const auto& [key, other] : theirs) differs(key, "(absent)", other);
  if (count > kMostKeys) text += fmt::format("  and {} more\n", count - kMostKeys);
  return text;
}

}  // namespace lithe::robot
