// SPDX-License-Identifier: Apache-2.0
// A certificate, and the state of a chain of them, for the person at the terminal.
#pragma once

#include <string>

#include "supervisor/core/answer.hpp"

namespace lithe::cli {

using swap::Json;

// Contract: prints to stdout and nothing else · any JSON object is safe: what is not there is left out.
void print_certificate(const std::string& file, const Json& certificate);
void print_chain(const Json& chain);

}  // namespace lithe::cli
