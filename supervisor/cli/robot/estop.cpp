// SPDX-License-Identifier: Apache-2.0
// The e-stop is written straight to shared memory: it works without a supervisor and does not wait for one.
#include <fmt/format.h>

#include <chrono>
#include <exception>
#include <iostream>
#include <set>
#include <thread>

#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/segment.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/link/client/client.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::cli {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;

constexpr std::int64_t kSeenWithinNs = 500 * kNsPerMs;
constexpr int kAskMs = 1000;

// Waits until a tick says that it has seen the word.
Answer confirm(const std::string& robot, std::int64_t deadline_ns) {
  const auto spine = Spine::attach(robot, ipc::Access::read);
  if (!spine || !ipc::Lease::is_held(Spine::path(robot))) {
    return Refusal{"robot_fault", fmt::format("the Spine of '{}' is not alive", robot),
                   "its drives' watchdogs stop the robot; if it moves, cut its power"};
  }
  const ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry((*spine)->telemetry);
  wire::Telemetry now{};
  do {
    if (telemetry.latest(now) && now.mode == static_cast<std::uint32_t>(wire::Mode::estop))
      return Json{{"robot", robot}, {"mode", "estop"}, {"tick", now.tick}};
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  } while (monotonic_ns() < deadline_ns);
  return Refusal{"robot_fault", fmt::format("the Spine of '{}' has not obeyed the e-stop", robot), "cut its power"};
}

// Without write permission, or with another memory layout, the supervisor is asked instead.
Answer ask_supervisor(Context context, const std::string& robot, const std::string& why) {
  context.robot = robot;
  const Answer answer = try_ask(context, "estop", Json::object(), kAskMs);
  if (const auto* refusal = std::get_if<Refusal>(&answer)) {
    const bool ticks = ipc::Lease::is_held(Spine::path(robot));
    return Refusal{ticks ? "robot_fault" : refusal->code, fmt::format("{}; {}", why, refusal->message),
                   "if the robot moves, cut its power"};
  }
  Json stopped = std::get<Json>(answer);
  stopped["robot"] = robot;
  return stopped;
}

// A failure at one robot must not keep the others from being stopped.
template <class Step>
Answer whatever_happens(const std::string& robot, Step step) {
  try {
    return step();
  } catch (const std::exception& wrong) {
    return Refusal{"robot_fault", fmt::format("the e-stop of '{}' went wrong: {}", robot, wrong.what()),
                   "cut its power"};
  }
}

struct Target {
  std::string robot;
  Answer pressed;
};

// First all e-stop words are set; nothing is looked up, asked or waited for before that.
std::vector<Target> press_all(const Context& context) {
  const std::set<std::string> robots =
      context.robot.empty() ? control::robots_with_memory() : std::set<std::string>{context.robot};
  std::vector<Target> targets;
  for (const std::string& robot : robots) {
    targets.push_back({robot, whatever_happens(robot, [&robot]() -> Answer {
                         const auto pressed = control::press_estop(robot);
                         return pressed ? Answer(Json::object()) : Answer(Refusal{"no_robot", pressed.message(), ""});
                       })});
  }
  if (!context.robot.empty()) return targets;
  // Files of a crashed run do not count as robots; a supervisor without segments does.
  const std::vector<std::string> served = control::running_robots();
  std::erase_if(targets, [&served](const Target& each) {
    return !ipc::Lease::is_held(Spine::path(each.robot)) && !contains(served, each.robot);
  });
  for (const std::string& robot : served)
    if (robots.count(robot) == 0)
      targets.push_back({robot, Refusal{"no_robot", fmt::format("'{}' has no shared memory", robot), ""}});
  return targets;
}

int report(const Context& context, const std::vector<std::pair<std::string, Answer>>& answers) {
  if (answers.size() == 1) {
    return finish(context, value_of(answers.front().second),
                  [](const Json& result) { print_command("estop", result); });
  }
  Json robots = Json::array();
  std::vector<std::string> failed;
  for (const auto& [robot, answer] : answers) {
    if (const auto* refusal = std::get_if<Refusal>(&answer)) {
      failed.push_back(robot);
      robots.push_back({{"robot", robot}, {"error", refusal->to_json()}});
      if (!context.json) std::cerr << robot << ": " << refusal->message << '\n';
    } else {
      robots.push_back(std::get<Json>(answer));
      if (!context.json) fmt::print("{}: ", robot);
      if (!context.json) print_command("estop", robots.back());
    }
  }
  std::fflush(stdout);
  if (!failed.empty()) {
    return refuse(context, {"robot_fault",
                            fmt::format("{} of {} robots have not confirmed the e-stop: {}", failed.size(),
                                        answers.size(), joined(failed)),
                            "cut their power",
                            {{"robots", robots}}});
  }
  Json result = std::get<Json>(answers.front().second);
  result["robots"] = robots;
  return finish(context, result, [](const Json&) {});
}

}  // namespace

int estop(const Context& context) {
  // Without a name all robots are stopped: there is no question while robots move.
  const std::vector<Target> targets = press_all(context);
  const std::int64_t deadline_ns = monotonic_ns() + kSeenWithinNs;
  if (targets.empty())
    return refuse(context, {"no_robot", "no robot is ticking here", "if a robot moves, cut its power"});
  std::vector<std::pair<std::string, Answer>> answers;
  for (const Target& each : targets) {
    answers.emplace_back(each.robot, whatever_happens(each.robot, [&]() -> Answer {
                           const auto* refusal = std::get_if<Refusal>(&each.pressed);
                           return refusal == nullptr ? confirm(each.robot, deadline_ns)
                                                     : ask_supervisor(context, each.robot, refusal->message);
                         }));
  }
  return report(context, answers);
}

}  // namespace lithe::cli
