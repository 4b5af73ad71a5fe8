// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/act.hpp"

#include <fmt/format.h>

#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <optional>
#include <thread>

#include "supervisor/cli/print.hpp"
#include "supervisor/cli/status_text.hpp"
#include "supervisor/cli/talk.hpp"

namespace lithe::cli {
namespace {

// NAME=VALUE into `values`; false when it is not one.
bool add_pair(const std::string& name, const std::string& text, Json& values) {
  double value = 0.0;
  const auto [end, failure] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (name.empty() || failure != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    return false;
  }
  values[name] = value;
  return true;
}

std::optional<Json> pairs(const std::vector<std::string>& words) {
  Json values = Json::object();
  if (words.size() == 2 && words[0].find('=') == std::string::npos) {
    return add_pair(words[0], words[1], values) ? std::optional(values) : std::nullopt;
  }
  for (const std::string& word : words) {
    const std::size_t at = word.find('=');
    if (at == std::string::npos || !add_pair(word.substr(0, at), word.substr(at + 1), values)) {
      return std::nullopt;
    }
  }
  return values;
}

Refusal wrong_pairs() {
  return {"usage", "a parameter is NAME VALUE or NAME=VALUE, the value a finite number", "lithe param set kp 2.5"};
}

Look look_of(const Context& context) { return {wants_color(), context.units == "rad"}; }

}  // namespace

int status(const Context& context) {
  return finish(context, ask(context, "status", Json::object()),
                [&context](const Json& result) { fmt::print("{}", status_text(result, look_of(context))); });
}

int command(const Context& context, const std::string& verb) {
  return finish(context, ask(context, verb, Json::object()), [&verb](const Json& result) {
    if (verb == "shutdown") {
      fmt::print("supervisor {} is stopping the robot\n", result.value("pid", 0));
    } else {
      print_command(verb, result);
    }
  });
}

int rollback(const Context& context, int steps) {
  return finish(context, ask(context, "rollback", {{"steps", steps}}),
                [](const Json& result) { print_command("rollback", result); });
}

int param_get(const Context& context, const std::string& name) {
  Answer answer = ask(context, "params", Json::object());
  if (Json* result = std::get_if<Json>(&answer); result != nullptr && !name.empty()) {
    Json chosen = Json::array();
    for (const Json& each : (*result)["params"]) {
      if (each["name"] == name) {
        chosen.push_back(each);
      }
    }
    if (chosen.empty()) {
      return refuse(context, {"unknown_param", fmt::format("the running law has no parameter '{}'", name),
                              "see them all: lithe param get"});
    }
    (*result)["params"] = chosen;
  }
  return finish(context, answer, print_params);
}

int param_set(const Context& context, const std::vector<std::string>& words) {
  const auto values = pairs(words);
  if (!values) {
    return refuse(context, wrong_pairs());
  }
  return finish(context, ask(context, "set_params", {{"values", *values}}, kCompileMs), print_params);  // behind swaps
}

int param_revert(const Context& context) {
  return finish(context, ask(context, "revert_params", Json::object()), print_params);
}

int events(const Context& context, std::uint64_t since, bool follow) {
  auto client = connect(context);
  if (const auto* refusal = std::get_if<Refusal>(&client)) {
    return refuse(context, *refusal);
  }
  for (;;) {
    const Answer answer = std::get<control::Client>(client).call("events", {{"since", since}}, kQuickMs);
    const Json* result = std::get_if<Json>(&answer);
    if (!follow || result == nullptr) {
      return finish(context, answer, print_events);
    }
    if (context.json && !(*result)["events"].empty()) {
      for (const Json& each : (*result)["events"]) {
        std::cout << swap::dump_line(each) << std::endl;  // following never ends, so it prints lines
      }
    } else if (!context.json) {
      print_events(swap::printable_json(*result));
      std::fflush(stdout);
    }
    since = (*result)["cursor"].get<std::uint64_t>();
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
}

int top(const Context& context, int turns) {
  if (context.json) {
    return status(context);
  }
  auto client = connect(context);
  if (const auto* refusal = std::get_if<Refusal>(&client)) {
    return refuse(context, *refusal);
  }
  for (int turn = 0; turns == 0 || turn < turns; ++turn) {
    if (turn > 0) {
      std::this_thread::sleep_for(std::chrono::milliseconds(250));
    }
    if (std::get<control::Client>(client).pulse() != control::Client::Pulse::answers) {
      client = connect(context);  // says why
      if (const auto* refusal = std::get_if<Refusal>(&client)) return refuse(context, *refusal);
    }
    const Answer answer = std::get<control::Client>(client).call("status", Json::object(), kQuickMs);
    if (const auto* refusal = std::get_if<Refusal>(&answer)) {
      return refuse(context, *refusal);
    }
    fmt::print("\x1b[H\x1b[2J");  // home, clear
    fmt::print("{}", status_text(swap::printable_json(std::get<Json>(answer)), look_of(context)));
    fmt::print("\nCtrl-C leaves; the robot goes on\n");
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace lithe::cli
