// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/read/reader.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <type_traits>

#include "spine/core/text.hpp"

namespace lithe::robot {
namespace {

std::string_view type_name(const toml::node& node) {
  if (node.is_table()) return "a table";
  if (node.is_array()) return "an array";
  if (node.is_string()) return "a string";
  if (node.is_integer()) return "an integer";
  if (node.is_floating_point()) return "a number with a fraction";
  return node.is_boolean() ? "true or false" : "a date or time";
}

bool is_identifier(std::string_view text) {
  return !text.empty() && text.size() <= 31 && text.front() != '-' && std::all_of(text.begin(), text.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
  });
}

}  // namespace

Place place_of(const toml::node& node) {
  return {std::max(node.source().begin.line, toml::source_index{1}),
          std::max(node.source().begin.column, toml::source_index{1})};
}

// What [defaults] says is told by each joint and device. The law to start with is no property of the robot.
void Reader::holds(std::string_view key, std::string_view value) {
  if (const std::string whole = name(key); !where_.starts_with("[defaults") && whole != "law")
    report_.holds(whole, value);
}

// At the end of its scope: tells which value holds, given in the file or not.
template <class Value>
struct Reader::Holds {
  Reader& in;
  std::string_view key;
  const Value& value;
  ~Holds() { in.holds(key, fmt::format("{}", value)); }
};

std::string Reader::name(std::string_view key) const {
  return where_.empty() ? std::string(key) : fmt::format("{}: {}", where_, key);
}

void Reader::complain(std::string_view key, const std::string& what) {
  const toml::node* node = table_.get(key);
  if (node == nullptr && defaults_ != nullptr) node = defaults_->get(key);
  report_.add(place_of(node != nullptr ? *node : table_), fmt::format("{}: {}", name(key), what));
}

const toml::node* Reader::find(std::string_view key, Need need) {
  known_.push_back(key);
  const toml::node* node = table_.get(key);
  const bool by_default = defaults_ != nullptr && defaults_->get(key) != nullptr;
  if (node == nullptr && need == Need::required && !by_default)
    report_.add(place_of(table_), fmt::format("{} is missing; add `{} = ...` here", name(key), key));
  return node;
}

void Reader::wrong_type(std::string_view key, const toml::node& node, std::string_view wanted) {
  complain(key, fmt::format("this is {}; give {}", type_name(node), wanted));
}

void Reader::number(std::string_view key, double& out, Range range, Need need) {
  const Holds<std::remove_reference_t<decltype(out)>> told{*this, key, out};
  const toml::node* node = find(key, need);
  if (node == nullptr) return;
  const std::string wanted = fmt::format("a number from {} to {}", range.min, range.max);
  if (!node->is_number()) return wrong_type(key, *node, wanted);
  take(key, node->value<double>().value_or(std::nan("")), range, wanted, out);
}

void Reader::numbers(std::string_view key, std::span<double> out, Range range) {
  const Holds<std::span<double>> told{*this, key, out};
  const toml::node* node = find(key, Need::optional);
  if (node == nullptr) return;
  const std::string wanted = fmt::format("a list of {} numbers from {} to {}", out.size(), range.min, range.max);
  const toml::array* list = node->as_array();
  if (list == nullptr || list->size() != out.size()) return wrong_type(key, *node, wanted);
  for (std::size_t i = 0; i < out.size(); ++i) {
    if (!list->get(i)->is_number()) return wrong_type(key, *list->get(i), wanted);
    take(key, list->get(i)->value<double>().value_or(std::nan("")), range, wanted, out[i]);
  }
}

void Reader::read_integer(std::string_view key, std::int64_t& out, Range range, Need need) {
  const toml::node* node = find(key, need);
  if (node == nullptr) return;
  const std::string wanted = fmt::format("an integer from {:.0f} to {:.0f}", range.min, range.max);
  if (!node->is_integer()) return wrong_type(key, *node, wanted);
  take(key, node->value<std::int64_t>().value_or(0), range, wanted, out);
}

template <class Number>
void Reader::take(std::string_view key, Number value, Range range, std::string_view wanted, Number& out) {
  const auto as_double = static_cast<double>(value);
  if (!(as_double >= range.min && as_double <= range.max))
    return complain(key, fmt::format("{} will not do; give {}", value, wanted));
  out = value;
}

void Reader::boolean(std::string_view key, bool& out) {
  const Holds<std::remove_reference_t<decltype(out)>> told{*this, key, out};
  const toml::node* node = find(key, Need::optional);
  if (node == nullptr) return;
  if (!node->is_boolean()) return wrong_type(key, *node, "true or false, without quotes");
  out = node->value<bool>().value_or(out);
}

void Reader::text(std::string_view key, std::string& out, Need need) {
  const Holds<std::remove_reference_t<decltype(out)>> told{*this, key, out};
  const toml::node* node = find(key, need);
  if (node == nullptr) return;
  if (!node->is_string()) return wrong_type(key, *node, "a string in quotes");
  out = node->value<std::string>().value_or(std::string());
  if (is_printable(out)) return;
  complain(key, fmt::format("\"{}\" holds characters that are not printable; write it without them", out));
  out.clear();
}

void Reader::texts(std::string_view key, std::vector<std::string>& out, Need need) {
  const toml::node* node = find(key, need);
  if (node == nullptr) return;
  const std::string_view wanted = "a list of strings: [\"one\", \"two\"]";
  if (!node->is_array()) return wrong_type(key, *node, wanted);
  for (const toml::node& each : *node->as_array()) {
    if (!each.is_string()) return wrong_type(key, each, wanted);
    const std::string text = each.value<std::string>().value_or(std::string());
    if (!is_printable(text))
      return complain(key, "one of its strings is not printable; write it without such characters");
    out.push_back(text);
  }
}

void Reader::identifier(std::string_view key, std::string& out, Need need) {
  text(key, out, need);
  const toml::node* node = table_.get(key);
  if (node == nullptr || !node->is_string() || is_identifier(out)) return;
  if (out.empty() && !node->value<std::string_view>()->empty()) return;  // not text: reported already
  complain(key, fmt::format("\"{}\" is no name; give 1 to 31 of a-z A-Z 0-9 - _, not starting with -", out));
  out.clear();
}

void Reader::core(std::string_view key, int& out) {
  const Holds<std::remove_reference_t<decltype(out)>> told{*this, key, out};
  const toml::node* node = find(key, Need::optional);
  if (node == nullptr) return;
  if (node->is_string() && node->value<std::string_view>() == "auto") {
    out = -1;
    return;
  }
  if (!node->is_integer()) return wrong_type(key, *node, "a core number or \"auto\"");
  const std::int64_t value = node->value<std::int64_t>().value_or(-1);
  if (value < 0 || value > 1023) return complain(key, fmt::format("{} is no core; give 0 to 1023 or \"auto\"", value));
  out = static_cast<int>(value);
}

std::size_t Reader::read_choice(std::string_view key, const std::vector<std::string_view>& words, Need need) {
  const toml::node* node = find(key, need);
  if (node == nullptr) return words.size();
  const std::string wanted = fmt::format("one of \"{}\"", fmt::join(words, "\", \""));
  if (!node->is_string()) {
    wrong_type(key, *node, wanted);
    return words.size();
  }
  const std::string word = node->value<std::string>().value_or(std::string());
  const auto found = std::find(words.begin(), words.end(), word);
  if (found != words.end()) return static_cast<std::size_t>(found - words.begin());
  const std::string_view close = nearest(word, words);
  const std::string hint = close.empty() ? std::string() : fmt::format(" (did you mean \"{}\"?)", close);
  complain(key, fmt::format("\"{}\" is not known{}; give {}", word, hint, wanted));
  return words.size();
}

void Reader::reference(std::string_view key, std::size_t& out, std::string_view kind,
                       const std::vector<std::string_view>& names, Need need) {
  const toml::node* node = find(key, need);
  if (node == nullptr) return out < names.size() ? holds(key, names[out]) : void();
  if (!node->is_string()) return wrong_type(key, *node, fmt::format("the name of a [[{}]] in quotes", kind));
  const std::string word = node->value<std::string>().value_or(std::string());
  const auto found = std::find(names.begin(), names.end(), word);
  if (found != names.end()) {
    out = static_cast<std::size_t>(found - names.begin());
    return holds(key, word);
  }
  complain(key, fmt::format("there is no [[{}]] named \"{}\"{}", kind, word,
                            names.empty() ? fmt::format("; add one") : suggestion(word, names)));
}

const toml::table* Reader::table(std::string_view key) {
  const toml::node* node = find(key, Need::optional);
  if (node == nullptr) return nullptr;
  if (node->is_table()) return node->as_table();
  wrong_type(key, *node, fmt::format("a table: write [{}] on a line of its own", key));
  return nullptr;
}

std::vector<const toml::table*> Reader::tables(std::string_view key, Need need) {
  std::vector<const toml::table*> found;
  const toml::node* node = find(key, Need::optional);
  if (node == nullptr) {
    if (need == Need::required)
      report_.add(place_of(table_), fmt::format("there is no [[{}]]; a robot needs at least one", key));
    return found;
  }
  const std::string wanted = fmt::format("a list of tables: write [[{}]] before each, with two brackets", key);
  const toml::array* array = node->as_array();
  if (array == nullptr) {
    wrong_type(key, *node, wanted);
    return found;
  }
  if (array->empty()) complain(key, fmt::format("is empty; a robot needs at least one [[{}]]", key));
  for (const toml::node& element : *array)
    if (element.is_table())
      found.push_back(element.as_table());
    else
      report_.add(place_of(element), fmt::format("{}: this is {}; give {}", name(key), type_name(element), wanted));
  return found;
}

void Reader::refuse(std::string_view key, std::string_view why) {
  if (table_.get(key) == nullptr) return;
  known_.push_back(key);
  complain(key, std::string(why));
}

void Reader::finish() {
  for (const auto& [key, node] : table_) {
    if (std::find(known_.begin(), known_.end(), key.str()) != known_.end()) continue;
    const Place place{std::max(key.source().begin.line, toml::source_index{1}),
                      std::max(key.source().begin.column, toml::source_index{1})};
    const std::string where = where_.empty() ? "at the top of the file" : fmt::format("in {}", where_);
    report_.add(place, fmt::format("'{}' is no key {}{}", key.str(), where, suggestion(key.str(), known_)));
  }
}

}  // namespace lithe::robot
