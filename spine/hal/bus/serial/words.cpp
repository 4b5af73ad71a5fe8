// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/serial/words.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <system_error>

namespace lithe::hal {
namespace {

template <class Call>
auto convert(Call call) LITHE_RT {
  LITHE_RT_EXEMPT("std::from_chars and std::to_chars: no heap, no lock, bounded by the length of the text",
                  { return call(); });
}

}  // namespace

bool read_number(std::string_view text, double& value) LITHE_RT {
  // A plus sign, which std::from_chars does not know. "infinity" and "nan(...)", which it does, are no numbers here.
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
  if (text.empty() || text.back() == ')' || text.back() == 'y' || text.back() == 'Y') return false;
  const char* const end = text.data() + text.size();
  double number = 0;
  const std::from_chars_result read = convert([&] { return std::from_chars(text.data(), end, number); });
  if (read.ptr != end || read.ec == std::errc::invalid_argument) return false;
  if (read.ec == std::errc::result_out_of_range) {
    const bool small = text.find("e-") != std::string_view::npos || text.find("E-") != std::string_view::npos;
    number = std::copysign(small ? 0.0 : std::numeric_limits<double>::infinity(), text[0] == '-' ? -1.0 : 1.0);
  }
  value = number;
  return true;
}

std::size_t write_number(double value, bool integer, std::span<char> out) LITHE_RT {
  constexpr double kMost = 1e15;
  double bounded = std::isnan(value) ? std::abs(value) : value;                // not "-nan"
  if (std::isfinite(value)) bounded = std::clamp(value, -kMost, kMost) + 0.0;  // not "-0"
  char* const end = out.data() + out.size();
  const std::to_chars_result written =
      convert([&] { return std::to_chars(out.data(), end, bounded, std::chars_format::fixed, integer ? 0 : 6); });
  return written.ec == std::errc() ? static_cast<std::size_t>(written.ptr - out.data()) : 0;
}

}  // namespace lithe::hal
