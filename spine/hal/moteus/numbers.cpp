// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/numbers.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

namespace lithe::hal {
namespace {

constexpr int kDigits = 17;  // more digits have no effect

bool is_digit(char c) LITHE_RT { return c >= '0' && c <= '9'; }

char small(char c) LITHE_RT { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; }

bool is_word(std::string_view text, std::string_view word) LITHE_RT {
  if (text.size() != word.size()) return false;
  for (std::size_t i = 0; i < word.size(); ++i) {
    if (small(text[i]) != word[i]) return false;
  }
  return true;
}

bool take_sign(std::string_view& text) LITHE_RT {
  if (text.empty() || (text[0] != '-' && text[0] != '+')) return false;
  const bool negative = text[0] == '-';
  text.remove_prefix(1);
  return negative;
}

// Reads digits and a point; returns the power of ten to apply.
bool take_digits(std::string_view& text, double& mantissa, int& exponent) LITHE_RT {
  bool any = false;
  bool point = false;
  int kept = 0;
  while (!text.empty() && (is_digit(text[0]) || (text[0] == '.' && !point))) {
    if (text[0] == '.') {
      point = true;
    } else {
      any = true;
      const bool keep = kept < kDigits;
      if (keep) mantissa = mantissa * 10 + (text[0] - '0');
      if (keep && (mantissa != 0 || point)) ++kept;
      exponent += keep ? (point ? -1 : 0) : (point ? 0 : 1);
    }
    text.remove_prefix(1);
  }
  return any;
}

bool take_exponent(std::string_view& text, int& exponent) LITHE_RT {
  if (text.empty() || small(text[0]) != 'e') return true;
  text.remove_prefix(1);
  const bool negative = take_sign(text);
  if (text.empty()) return false;
  int value = 0;
  while (!text.empty() && is_digit(text[0])) {
    value = std::min(value * 10 + (text[0] - '0'), 9999);
    text.remove_prefix(1);
  }
  exponent += negative ? -value : value;
  return true;
}

}  // namespace

bool read_number(std::string_view text, double& value) LITHE_RT {
  const bool negative = take_sign(text);
  const double sign = negative ? -1 : 1;
  if (is_word(text, "nan")) {
    value = std::numeric_limits<double>::quiet_NaN();
    return true;
  }
  if (is_word(text, "inf")) {
    value = sign * std::numeric_limits<double>::infinity();
    return true;
  }
  double mantissa = 0;
  int exponent = 0;
  if (!take_digits(text, mantissa, exponent) || !take_exponent(text, exponent) || !text.empty()) return false;
  exponent = std::clamp(exponent, -400, 400);
  double power = 1;
  for (int i = std::abs(exponent); i > 0; --i) power *= 10;
  value = sign * (exponent < 0 ? mantissa / power : mantissa * power);
  if (mantissa == 0) value = 0;  // and not 0 times infinity
  return true;
}

std::size_t write_number(double value, bool integer, std::span<char> out) LITHE_RT {
  std::array<char, kLongestNumber> back{};  // last digit first
  std::size_t length = 0;
  const double size = std::abs(value);
  if (!std::isfinite(value)) {
    for (const char c : std::isnan(value) ? std::string_view("nan") : std::string_view("fni")) back[length++] = c;
  } else {
    constexpr double kMost = 1e15;
    constexpr std::uint64_t kMillion = 1'000'000;
    const double bounded = std::min(size, kMost);
    const auto whole = static_cast<std::uint64_t>(bounded);
    auto parts = static_cast<std::uint64_t>((bounded - static_cast<double>(whole)) * 1e6 + 0.5);
    std::uint64_t rest = whole + (parts >= kMillion ? 1 : 0);
    if (parts >= kMillion) parts -= kMillion;
    for (int i = 0; !integer && i < 6; ++i, parts /= 10) back[length++] = static_cast<char>('0' + parts % 10);
    if (!integer) back[length++] = '.';
    do {
      back[length++] = static_cast<char>('0' + rest % 10);
      rest /= 10;
    } while (rest != 0);
  }
  if (value < 0) back[length++] = '-';
  if (length > out.size()) return 0;
  for (std::size_t i = 0; i < length; ++i) out[i] = back[length - 1 - i];
  return length;
}

}  // namespace lithe::hal
