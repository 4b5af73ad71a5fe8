// SPDX-License-Identifier: Apache-2.0
// Prints answers on the terminal (for the status: status_text.hpp). Every function prints to stdout only.
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
