// SPDX-License-Identifier: Apache-2.0
// Short questions about lists, texts and numbers in texts. Off the tick.
#pragma once

#include <algorithm>
#include <charconv>
#include <optional>
#include <string_view>
#include <system_error>

namespace lithe {

// Whether a list has a value.
template <class List, class Value>
bool contains(const List& list, const Value& value) {
  return std::ranges::find(list, value) != std::ranges::end(list);
}

// Whether a text has another one in it.
inline bool has_text(std::string_view text, std::string_view part) { return text.find(part) != std::string_view::npos; }

// The number at the start of a text, whatever follows; 0 when there is none, or it is too large.
template <class Number>
Number leading_number(std::string_view text, int base = 10) {
  Number number = 0;
  std::from_chars(text.data(), text.data() + text.size(), number, base);
  return number;
}

// A number that is the whole text; nothing otherwise. Unsigned types accept digits only.
template <class Number = long long>
std::optional<Number> whole_number(std::string_view text, int base = 10) {
  Number number = 0;
  const char* const last = text.data() + text.size();
  const auto [end, error] = std::from_chars(text.data(), last, number, base);
  if (error != std::errc() || end != last || text.empty()) return std::nullopt;
  return number;
}

}  // namespace lithe
