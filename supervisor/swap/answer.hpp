// SPDX-License-Identifier: Apache-2.0
// How the supervisor says no: a word a program can test, a sentence, and the next thing to do.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <variant>

namespace lithe::swap {

// Key order is kept, so that a record reads in the order things happened.
using Json = nlohmann::ordered_json;

struct Refusal {
  std::string code;       // one snake_case word: "compile_failed", "refused_mode", "usage" ...
  std::string message;    // what is wrong and where
  std::string next;       // what to do about it
  Json detail = nullptr;  // diagnostics of a compiler, the record of a refused swap

  Json to_json() const {
    Json out = {{"code", code}, {"message", message}, {"next", next}};
    if (!detail.is_null()) {
      out["detail"] = detail;
    }
    return out;
  }
};

using Answer = std::variant<Json, Refusal>;

// Text that may hold any byte (a compiler's output, a client's source) as one line of valid JSON.
inline std::string dump_line(const Json& json) { return json.dump(-1, ' ', false, Json::error_handler_t::replace); }

}  // namespace lithe::swap
