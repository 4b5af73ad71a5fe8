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

// `output`: stderr of g++ -fdiagnostics-format=json. `path`: the file it compiled, shown as `name`. A message of the
// contract (it starts with "LITHE:") is moved from the header to the line of the law it is about, and what follows
// from it is dropped.
Diagnostics read_diagnostics(const std::string& output, const std::string& path, const std::string& name,
                             const std::string& source);

}  // namespace lithe::lawd
