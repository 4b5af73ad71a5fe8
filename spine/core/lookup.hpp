// SPDX-License-Identifier: Apache-2.0
// Short questions about lists, texts and numbers in texts. Off the tick.
#pragma once

#include <algorithm>
#include <charconv>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

namespace lithe {

// Whether a list has a value.
template <class List, class Value>
bool contains(const List& list, const Value& value) {
  return std::ranges::find(list, value) != std::ranges::end(list);
}

// Whether a text has another one in it.
inline bool has_text(std::string_view text, std::string_view part) { return text.find(part) != std::string_view::npos; }

// The texts of a list, with something between them: "a, b". `text_of`: what the text of one is.
template <class List, class Text = std::identity>
std::string joined(const List& list, Text text_of = {}, std::string_view between = ", ") {
  std::string all;
  for (const auto& each : list) {
    if (!all.empty()) all += between;
    all += std::invoke(text_of, each);
  }
  return all;
}

// The lines of a text, without their ends; they point into it.
inline std::vector<std::string_view> lines_in(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    lines.push_back(text.substr(0, text.find('\n')));
    text.remove_prefix(std::min(lines.back().size() + 1, text.size()));
  }
  return lines;
}

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
