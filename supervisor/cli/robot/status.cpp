// SPDX-License-Identifier: Apache-2.0
// `lithe status`, `top` and `events`, and the verbs that are one command of the Spine.
#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <set>
#include <string>
#include <thread>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/robot/status_text.hpp"
#include "supervisor/events/event_log.hpp"
#include "supervisor/link/client/client.hpp"

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

int command(const Context& context, const std::string& verb, const Json& args) {
  return finish(context, ask(context, verb, args), [&verb](const Json& result) {
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
  const bool screen = isatty(STDOUT_FILENO) == 1;
  if (!screen && turns == 0) turns = 1;  // a file or a pipe gets one picture
  auto client = value_of(connect(context));
  for (int turn = 0; turns == 0 || turn < turns; ++turn) {
    if (turn > 0) std::this_thread::sleep_for(std::chrono::milliseconds(250));
    if (client.pulse() != control::Client::Pulse::answers) client = value_of(connect(context));  // says why
    const Json status = value_of(client.call("status", Json::object(), kQuickMs));
    if (screen) fmt::print("\x1b[H\x1b[2J");  // home, clear
    fmt::print("{}", status_text(control::printable_json(status), look_of(context)));
    if (screen) fmt::print("\nCtrl-C leaves; the robot goes on\n");
    std::fflush(stdout);
  }
  return 0;
}

// `lithe recover`: sends the command, then waits until it has ended.

namespace {

constexpr auto kStatusEvery = std::chrono::milliseconds(100);

// The Spine's reason when recover failed.
std::string last_stop(const Context& context) {
  const Answer answer = try_ask(context, "events", Json::object());
  std::string text;
  if (const Json* result = std::get_if<Json>(&answer)) {
    for (const Json& event : (*result)["events"])
      if (event.value("kind", "") == "safe_stop") text = event.value("text", "");
  }
  return text;
}

Refusal why_not(const Context& context, const Json& status) {
  const std::string mode = status.value("mode", "?"), fault = status.value("fault", "none");
  if (mode != "safe_stop") {
    return {"refused_mode", fmt::format("the recovery was ended from elsewhere: the robot is in mode {}", mode),
            "see how the robot is: lithe status"};
  }
  const std::string said = last_stop(context);
  return {fault, fmt::format("not recovered: {}", said.empty() ? fault : said),
          fault == "recover_failed" ? "take the load away, move the joint by hand (lithe disarm), or raise "
                                      "recover_torque_share in [guard]; then again: lithe recover"
                                    : "find the cause (lithe status), then: lithe reset, then again: lithe recover"};
}

}  // namespace

int recover(const Context& context) {
  ask(context, "recover", Json::object());
  Json status;
  do {
    if (!status.is_null()) std::this_thread::sleep_for(kStatusEvery);
    status = ask(context, "status", Json::object());
    if (status.value("mode", "") != "recover") throw why_not(context, status);
  } while (status.value("recovering", true));
  return finish(context, status, [](const Json& now) {
    fmt::print("every joint is inside its limits and held there (mode {})\nnext: lithe arm, or lithe disarm\n",
               now.value("mode", "?"));
  });
}

// `lithe list`: the robots of this machine, also those whose Spine ticks without a supervisor.

namespace {

std::string with_pid(const Json& pid, const std::string& what) {
  return pid.is_number() && pid > 0 ? fmt::format("pid {} {}", pid.get<int>(), what) : what;
}

void print_list(const Json& list) {
  if (list["robots"].empty())
    return fmt::print("no robot runs here (looked in {}); start one: lithe run robots/arm.toml\n", run_dir());
  fmt::print("{:<14} {:<10} {:<16} {:>10}  {:<24} {}\n", "robot", "mode", "law", "tick", "supervisor", "Spine");
  for (const Json& each : list["robots"]) {
    const std::string spine = each["spine_pid"].is_null()
                                  ? "none"
                                  : with_pid(each["spine_pid"], each["ticks"].is_null() ? "cannot be read"
                                                                : each["ticks"] == true ? "ticks"
                                                                                        : "does not tick");
    fmt::print("{:<14} {:<10} {:<16} {:>10}  {:<24} {}\n", each["robot"].get<std::string>(),
               each["mode"].get<std::string>(), each["law"].get<std::string>(), each["tick"].get<std::uint64_t>(),
               with_pid(each["supervisor_pid"], each["supervisor"].get<std::string>()), spine);
  }
}

}  // namespace

int list(const Context& context) {
  Json robots = Json::array();
  for (const std::string& name : control::known_robots()) {
    if (!context.robot.empty() && name != context.robot) continue;
    const control::Presence there = control::look_for(name);
    if (there.is_there()) robots.push_back(control::presence_json(there));
  }
  return finish(context, Json{{"robots", robots}}, print_list);
}

}  // namespace lithe::cli
