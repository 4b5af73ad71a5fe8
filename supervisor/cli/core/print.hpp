// SPDX-License-Identifier: Apache-2.0
// Fields of answers as text, and what several verbs print.
#pragma once

#include <string>

#include "supervisor/core/answer.hpp"

namespace lithe::cli {

using control::Json;

// A field of an answer; 0 and "-" when it is missing or null (JSON has no NaN).
double number(const Json& object, const char* key);
std::string word(const Json& object, const char* key);

// "a, b": the texts of an array.
std::string listed(const Json& words);

// A line for each of the `warnings` and `hints` of this object.
std::string warning_lines(const Json& from, const char* indent);
// What the compile service took off or replaced around a law's code, one line each.
std::string cleaned_lines(const Json& from);

// Prints what a command of the Spine has done.
void print_command(const std::string& verb, const Json& result);

}  // namespace lithe::cli
