// SPDX-License-Identifier: Apache-2.0
// Typed access to one TOML table. Every key that is read is known; every other key is an error.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "spine/robot/read/report.hpp"
#include "spine/robot/read/toml.hpp"

namespace lithe::robot {

Place place_of(const toml::node& node);

enum class Need { optional, required };

struct Range {
  double min;
  double max;
};

// Contract: never in the tick · reads a table it does not own · a missing or wrong value leaves `out` unchanged
class Reader {
 public:
  // `defaults` may be null; a required key may be in `defaults` instead.
  Reader(const toml::table& table, std::string where, Report& report, const toml::table* defaults = nullptr)
      : table_(table), where_(std::move(where)), report_(report), defaults_(defaults) {}

  void number(std::string_view key, double& out, Range range, Need need = Need::optional);
  // A list of exactly so many numbers.
  void numbers(std::string_view key, std::span<double> out, Range range);
  template <class Int>
  void integer(std::string_view key, Int& out, Range range, Need need = Need::optional) {
    std::int64_t value = static_cast<std::int64_t>(out);
    read_integer(key, value, range, need);
    out = static_cast<Int>(value);
    holds(key, std::to_string(value));
  }
  void boolean(std::string_view key, bool& out);
  void text(std::string_view key, std::string& out, Need need = Need::optional);
  void texts(std::string_view key, std::vector<std::string>& out, Need need = Need::optional);  // a list of strings
  void identifier(std::string_view key, std::string& out, Need need = Need::required);  // a-z A-Z 0-9 - _, at most 31
  void core(std::string_view key, int& out);                                            // a core number or "auto"

  // False: what stands there is none of the choices.
  template <class T>
  bool choice(std::string_view key, T& out, const std::vector<std::pair<std::string_view, T>>& choices,
              Need need = Need::optional) {
    std::vector<std::string_view> words;
    for (const auto& [word, value] : choices) words.push_back(word);
    const std::size_t mistakes = report_.count();
    const std::size_t index = read_choice(key, words, need);
    if (index < choices.size()) out = choices[index].second;
    for (const auto& [word, value] : choices)
      if (value == out) holds(key, word);
    return report_.count() == mistakes || table_.get(key) == nullptr;
  }

  // A reference by name. `kind` names what it refers to: `device`, `bus`.
  void reference(std::string_view key, std::size_t& out, std::string_view kind,
                 const std::vector<std::string_view>& names, Need need = Need::required);

  const toml::table* table(std::string_view key);                                            // null when absent
  std::vector<const toml::table*> tables(std::string_view key, Need need = Need::required);  // of [[key]]
  void refuse(std::string_view key, std::string_view why);  // a known key that is not allowed in this table
  void finish();                                            // reports every key that was not read

  void complain(std::string_view key, const std::string& what);  // at the key's value, or at the table
  std::string name(std::string_view key) const;

 private:
  template <class Value>
  struct Holds;
  void holds(std::string_view key, std::string_view value);
  const toml::node* find(std::string_view key, Need need);
  void read_integer(std::string_view key, std::int64_t& out, Range range, Need need);
  template <class Number>
  void take(std::string_view key, Number value, Range range, std::string_view wanted, Number& out);
  std::size_t read_choice(std::string_view key, const std::vector<std::string_view>& words, Need need);
  void wrong_type(std::string_view key, const toml::node& node, std::string_view wanted);

  const toml::table& table_;
  std::string where_;  // `[[joint]] shoulder`; empty at the top of the file
  Report& report_;
  const toml::table* defaults_;
  std::vector<std::string_view> known_;
};

}  // namespace lithe::robot
