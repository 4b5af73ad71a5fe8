// SPDX-License-Identifier: Apache-2.0
// `lithe status`, `top` and `events`, and the verbs that are one command of the Spine.
#include <fmt/format.h>

#include <chrono>
#include <cstdio>
#include <iostream>
#include <thread>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/print.hpp"
#include "supervisor/cli/core/talk.hpp"
#include "supervisor/cli/robot/status_text.hpp"
#include "supervisor/events/event_log.hpp"

namespace lithe::cli {
namespace {

void print_events(const Json& events) {
  if (const auto lost = events.value("lost", std::uint64_t{0}); lost != 0)
    fmt::print("({} older events are gone)\n", lost);
  for (const Json& each : events["events"]) {
    fmt::print("{:>6}  {:14.6f} s  {}\n", each.value("cursor", std::uint64_t{0}),
               static_cast<double>(each.value("t_ns", std::int64_t{0})) * 1e-9, control::event_line(each));
  }
}

Look look_of(const Context& context) { return {wants_color(), context.units == "rad"}; }

}  // namespace

int status(const Context& context) {
  return finish(context, ask(context, "status", Json::object()),
                [&context](const Json& result) { fmt::print("{}", status_text(result, look_of(context))); });
}

int command(const Context& context, const std::string& verb) {
  return finish(context, ask(context, verb, Json::object()), [&verb](const Json& result) {
    if (verb == "shutdown")
      fmt::print("supervisor {} is stopping the robot\n", result.value("pid", 0));
    else
      print_command(verb, result);
  });
}

int events(const Context& context, std::uint64_t since, bool follow) {
  auto client = value_of(connect(context));
  for (;;) {
    const Json result = value_of(client.call("events", {{"since", since}}, kQuickMs));
    if (!follow) return finish(context, result, print_events);
    if (context.json) {
      for (const Json& each : result["events"])
        std::cout << control::dump_line(each) << std::endl;  // following never ends, so it prints lines
    } else {
      print_events(control::printable_json(result));
      std::fflush(stdout);
    }
    since = result["cursor"].get<std::uint64_t>();
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
}

int top(const Context& context, int turns) {
  if (context.json) return status(context);
  auto client = value_of(connect(context));
  for (int turn = 0; turns == 0 || turn < turns; ++turn) {
    if (turn > 0) std::this_thread::sleep_for(std::chrono::milliseconds(250));
    if (client.pulse() != control::Client::Pulse::answers) client = value_of(connect(context));  // says why
    const Json status = value_of(client.call("status", Json::object(), kQuickMs));
    fmt::print("\x1b[H\x1b[2J");  // home, clear
    fmt::print("{}", status_text(control::printable_json(status), look_of(context)));
    fmt::print("\nCtrl-C leaves; the robot goes on\n");
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace lithe::cli
