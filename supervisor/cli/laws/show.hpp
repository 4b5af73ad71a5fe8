// SPDX-License-Identifier: Apache-2.0
// Prints a certificate, and the result of verifying a chain.
#pragma once

#include <string>

#include "supervisor/core/answer.hpp"

namespace lithe::cli {

using control::Json;

// Contract: prints to stdout and nothing else · any JSON object is safe: missing fields are left out
void print_certificate(const std::string& file, const Json& certificate);
void print_chain(const Json& chain);

}  // namespace lithe::cli
