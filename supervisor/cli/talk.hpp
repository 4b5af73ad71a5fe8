// SPDX-License-Identifier: Apache-2.0
// The way from a command line to a robot and back.
#pragma once

#include <functional>
#include <string>

#include "supervisor/cli/act.hpp"
#include "supervisor/link/client.hpp"

namespace lithe::cli {

using swap::Answer;
using swap::Json;
using swap::Refusal;

inline constexpr int kQuickMs = 10'000;
inline constexpr int kCompileMs = 180'000;

// One request to the robot the context means.
Answer ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms = kQuickMs);

// The name of the robot the context means, whether its supervisor answers or not.
std::variant<std::string, Refusal> which_robot(const Context& context);

// The connection itself, for more than one request. A supervisor that is stopped or says nothing is named within 2 s,
// and so is a Spine that ticks without one.
std::variant<control::Client, Refusal> connect(const Context& context);

// Prints a refusal (stderr, or one JSON document on stdout) and returns its exit code.
int refuse(const Context& context, const Refusal& refusal);

// Prints an answer: JSON as it is, else through `print`.
int finish(const Context& context, const Answer& answer, const std::function<void(const Json&)>& print);

}  // namespace lithe::cli
