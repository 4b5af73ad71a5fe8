// SPDX-License-Identifier: Apache-2.0
// Requests from the command line to a robot, and their answers.
#pragma once

#include <functional>
#include <string>
#include <utility>
#include <variant>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/link/client/client.hpp"

namespace lithe::cli {

using control::Answer;
using control::Json;
using control::Refusal;
using control::value_of;

inline constexpr int kQuickMs = 10'000;
inline constexpr int kCompileMs = 180'000;

// The value of a result; else throws a Refusal with this code and next step.
template <class T>
T value_of(Result<T> result, const char* code, const char* next) {
  if (!result) throw Refusal{code, result.message(), next};
  return std::move(*result);
}

// Sends one request to the context's robot. Throws the Refusal.
Json ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms = kQuickMs);
// The same, but returns a refusal instead of throwing it.
Answer try_ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms = kQuickMs);

// The name of the context's robot, also when its supervisor does not answer. Throws the Refusal.
std::string which_robot(const Context& context);

// The connection, for more than one request. A stopped or silent supervisor, or a Spine without one, is reported within
// 2 s.
std::variant<control::Client, Refusal> connect(const Context& context);

// Prints a refusal (stderr, or one JSON document on stdout) and returns its exit code.
int refuse(const Context& context, const Refusal& refusal);

// Prints a result: JSON as it is, else through `print`. Returns 0.
int finish(const Context& context, const Json& result, const std::function<void(const Json&)>& print);

}  // namespace lithe::cli
