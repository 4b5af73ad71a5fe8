// SPDX-License-Identifier: Apache-2.0
// The compiler's messages, as text and as JSON.
#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>

namespace lithe::lawd {

struct Diagnostics {
  nlohmann::json list;  // at most six, errors first: [{file, line, column, severity, message, text}]
  std::string text;     // the same, readable
};

// The compiled source.
struct Sources {
  std::string path;                                                  // path that the compiler read
  std::string name;                                                  // name to show
  std::string text;                                                  // source text
  std::string contract_dir;                                          // headers here may be quoted too
  std::function<std::string(const std::string& message)> with_help;  // adds what to write instead; empty = nothing
};

// `output`: stderr of g++ -fdiagnostics-format=json. A message of the contract (it starts with "LITHE:") is moved from
// the header to the line of the law it is about, and its follow-up errors are dropped. Text is quoted only from the
// law, the contract and the system's headers; of any other file only name and line are given.
Diagnostics read_diagnostics(const std::string& output, const Sources& sources);

}  // namespace lithe::lawd
