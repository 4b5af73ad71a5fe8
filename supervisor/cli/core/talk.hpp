// SPDX-License-Identifier: Apache-2.0
// Requests from the command line to a robot, and their answers.
#pragma once

#include <functional>
#include <string>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/link/client/client.hpp"

namespace lithe::cli {

using control::Answer;
using control::Json;
using control::Refusal;

inline constexpr int kQuickMs = 10'000;
inline constexpr int kCompileMs = 180'000;

// Sends one request to the context's robot.
Answer ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms = kQuickMs);

// The name of the context's robot, also when its supervisor does not answer.
std::variant<std::string, Refusal> which_robot(const Context& context);

// The connection, for more than one request. A stopped or silent supervisor, or a Spine without one, is reported within
// 2 s.
std::variant<control::Client, Refusal> connect(const Context& context);

// Prints a refusal (stderr, or one JSON document on stdout) and returns its exit code.
int refuse(const Context& context, const Refusal& refusal);

// Prints an answer: JSON as it is, else through `print`.
int finish(const Context& context, const Answer& answer, const std::function<void(const Json&)>& print);

}  // namespace lithe::cli
