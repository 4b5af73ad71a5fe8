// SPDX-License-Identifier: Apache-2.0
// What the compiler said, for a person and for an agent.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace lithe::lawd {

struct Diagnostics {
  nlohmann::json list;  // [{file, line, column, severity, message, text}], the law's own lines only where possible
  std::string text;     // the same, readable
};

// What was compiled.
struct Sources {
  std::string path;          // of the law as the compiler read it,
  std::string name;          // shown under this name,
  std::string text;          // and what it holds
  std::string contract_dir;  // where the headers are that may be quoted beside it and the system's
};

// `output`: stderr of g++ -fdiagnostics-format=json. A message of the contract (it starts with "LITHE:") is moved from
// the header to the line of the law it is about, and what follows from it is dropped. Of any file but the law, the
// contract and the system's headers nothing is repeated but its name and line.
Diagnostics read_diagnostics(const std::string& output, const Sources& sources);

}  // namespace lithe::lawd
