// SPDX-License-Identifier: Apache-2.0
// Tokenizer for a line of text; noexcept.
#pragma once

#include <cstddef>
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

}  // namespace lithe::hal
