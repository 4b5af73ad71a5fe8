// SPDX-License-Identifier: Apache-2.0
// Answers for the person at the terminal (the status: status_text.hpp). Every function prints to stdout and nothing
// else.
#pragma once

#include <string>

#include "supervisor/core/answer.hpp"

namespace lithe::cli {

using swap::Json;

void print_command(const std::string& verb, const Json& result);
void print_swap(const Json& certificate);
void print_params(const Json& params);
void print_check(const Json& result);
void print_laws(const Json& laws);
void print_events(const Json& events);

}  // namespace lithe::cli
