// SPDX-License-Identifier: Apache-2.0
#include "host/tune/values.hpp"

#include <algorithm>
#include <cstddef>
#include <iterator>

namespace lithe::host {
namespace {

constexpr std::size_t kCoresInADigit = 4;

}  // namespace

bool share_a_core(const std::vector<int>& some, const std::vector<int>& others) {
  return std::any_of(some.begin(), some.end(),
                     [&](int core) { return std::binary_search(others.begin(), others.end(), core); });
}

std::vector<int> cores_without(const std::vector<int>& cores, const std::vector<int>& others) {
  std::vector<int> rest;
  std::set_difference(cores.begin(), cores.end(), others.begin(), others.end(), std::back_inserter(rest));
  return rest;
}

std::string mask_of(const std::vector<int>& cores, const std::string& like) {
  std::string mask = like;
  std::size_t first = 0, fitted = 0;
  for (std::size_t i = mask.size(); i-- > 0;) {
    if (mask[i] == ',') continue;
    std::size_t digit = 0;
    for (std::size_t bit = 0; bit < kCoresInADigit; ++bit) {
      if (!std::binary_search(cores.begin(), cores.end(), static_cast<int>(first + bit))) continue;
      digit |= std::size_t{1} << bit;
      ++fitted;
    }
    mask[i] = "0123456789abcdef"[digit];
    first += kCoresInADigit;
  }
  return fitted == cores.size() ? mask : "";
}

std::string value_in_force(const std::string& text) {
  const std::size_t open = text.find('['), close = text.find(']');
  return open < close && close != std::string::npos ? text.substr(open + 1, close - open - 1) : text;
}

}  // namespace lithe::host
