// SPDX-License-Identifier: Apache-2.0
// Words, hexadecimal digits and numbers in a line of text; noexcept.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "spine/core/rt.hpp"

namespace lithe::hal {

constexpr bool begins(std::string_view text, std::string_view with) LITHE_RT {
  return text.size() >= with.size() && std::string_view(text.data(), with.size()) == with;
}

// The text up to the next `end`, which is removed too. Two ends in a row give an empty field.
constexpr std::string_view next_field(std::string_view& rest, char end = ' ') LITHE_RT {
  const std::size_t at = rest.find(end);
  const std::string_view field(rest.data(), at == std::string_view::npos ? rest.size() : at);
  rest.remove_prefix(at == std::string_view::npos ? rest.size() : at + 1);
  return field;
}

// The same, but several spaces count as one.
constexpr std::string_view next_word(std::string_view& rest) LITHE_RT {
  while (!rest.empty() && rest.front() == ' ') rest.remove_prefix(1);
  return next_field(rest);
}

inline constexpr char kHexDigits[] = "0123456789ABCDEF";

// 0 to 15; -1 for any other character. Upper or lower case.
constexpr int hex_digit(char c) LITHE_RT {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

// The number in `text` (1 to 8 digits and nothing else). False: not a number; `value` is unchanged.
constexpr bool hex_number(std::string_view text, std::uint32_t& value) LITHE_RT {
  if (text.empty() || text.size() > 8) return false;
  std::uint32_t number = 0;
  for (const char c : text) {
    const int digit = hex_digit(c);
    if (digit < 0) return false;
    number = number << 4 | static_cast<std::uint32_t>(digit);
  }
  value = number;
  return true;
}

// The bytes in `text`, two digits each, exactly as many as `bytes` holds. False: another length, or not hexadecimal.
constexpr bool hex_bytes(std::string_view text, std::span<std::uint8_t> bytes) LITHE_RT {
  if (text.size() != 2 * bytes.size()) return false;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    const int high = hex_digit(text[2 * i]);
    const int low = hex_digit(text[2 * i + 1]);
    if (high < 0 || low < 0) return false;
    bytes[i] = static_cast<std::uint8_t>(high << 4 | low);
  }
  return true;
}

// Numbers as text, without the heap and without the locale.
// Parses the whole text as a decimal number: sign, digits, point, exponent; or nan, inf. False: not a number.
// Contract: RT · pure
bool read_number(std::string_view text, double& value) LITHE_RT;

inline constexpr std::size_t kLongestNumber = 40;

// Formats without a point when `integer`, else with six digits after it; clamped to 1e15. The length, at most
// kLongestNumber; 0 when it does not fit.
std::size_t write_number(double value, bool integer, std::span<char> out) LITHE_RT;

}  // namespace lithe::hal
