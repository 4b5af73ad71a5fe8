// SPDX-License-Identifier: Apache-2.0
// Prints a certificate, and the result of verifying a chain.
#pragma once

#include <string>
#include <vector>

#include "supervisor/core/answer.hpp"

namespace lithe::cli {

using control::Json;

// Contract: prints to stdout and nothing else · any JSON object is safe: missing fields are left out
void print_certificate(const std::string& file, const Json& certificate);
void print_chain(const Json& chain);

// Parameter values as words of a command line, and as text.

// {"kp": 2.5} from "kp=2.5" ...; else throws a Refusal that names the word, with this example.
control::Json param_values(const std::vector<std::string>& words, const char* example);

// A row for each: name, value, range.
std::string param_rows(const control::Json& params);

}  // namespace lithe::cli
