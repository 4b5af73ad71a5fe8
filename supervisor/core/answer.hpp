// SPDX-License-Identifier: Apache-2.0
// A refusal: a code for programs, a sentence, and the next step.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <variant>

#include "spine/core/text.hpp"

namespace lithe::control {

// Key order is kept, so that a record reads in the order things happened.
using Json = nlohmann::ordered_json;

struct Refusal {
  std::string code;       // one snake_case word: "compile_failed", "refused_mode", "usage" ...
  std::string message;    // what is wrong and where
  std::string next;       // what to do about it
  Json detail = nullptr;  // diagnostics of a compiler, the record of a refused swap

  Json to_json() const {
    Json out = {{"code", code}, {"message", message}, {"next", next}};
    if (!detail.is_null()) out["detail"] = detail;
    return out;
  }
};

using Answer = std::variant<Json, Refusal>;

// The value of an outcome. Throws the Refusal if it is one: main() prints it, a verb answers with it.
template <class T>
T value_of(std::variant<T, Refusal> outcome) {
  if (auto* refusal = std::get_if<Refusal>(&outcome)) throw std::move(*refusal);
  return std::get<T>(std::move(outcome));
}

// Text that may hold any byte (a compiler's output, a client's source) as one line of valid JSON.
inline std::string dump_line(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

// printable() for every key and string, line ends kept: for text from clients and compilers.
inline Json printable_json(const Json& json) {
  if (json.is_string()) return printable(json.get_ref<const std::string&>(), true);
  if (!json.is_structured()) return json;
  Json out = json.is_array() ? Json::array() : Json::object();
  for (const auto& [key, value] : json.items())
    if (json.is_array())
      out.push_back(printable_json(value));
    else
      out[printable(key)] = printable_json(value);
  return out;
}

}  // namespace lithe::control
