// SPDX-License-Identifier: Apache-2.0
// The e-stop goes straight to shared memory: it needs no supervisor, and no supervisor can be too busy for it.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <chrono>
#include <filesystem>
#include <system_error>
#include <thread>

#include "spine/core/paths.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/segment.hpp"
#include "supervisor/cli/act.hpp"
#include "supervisor/cli/print.hpp"
#include "supervisor/cli/talk.hpp"
#include "supervisor/control/spine_link.hpp"

namespace lithe::cli {
namespace {

namespace fs = std::filesystem;
using Spine = ipc::Segment<ipc::SpineMemory>;

constexpr std::int64_t kSeenWithinNs = 500 * kNsPerMs;

// Robots whose Spine is alive, found by their segments.
std::vector<std::string> ticking_robots() {
  const fs::path pattern = shm_path("*", "spine");
  const std::string file = pattern.filename().string();
  const std::string before = file.substr(0, file.find('*'));
  const std::string after = file.substr(file.find('*') + 1);
  std::vector<std::string> robots;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(pattern.parent_path(), ignored)) {
    const std::string name = entry.path().filename().string();
    if (name.size() > before.size() + after.size() && name.starts_with(before) && name.ends_with(after)) {
      const std::string robot = name.substr(before.size(), name.size() - before.size() - after.size());
      if (control::live_spine(robot) != 0) {
        robots.push_back(robot);
      }
    }
  }
  return robots;
}

// Presses the word and waits until a tick says that it has seen it.
Answer press(const std::string& robot) {
  if (const auto pressed = control::press_estop(robot); !pressed) {
    return Refusal{"no_robot", pressed.message(), "if the robot moves, cut its power"};
  }
  const auto spine = Spine::attach(robot, ipc::Access::read);
  if (!spine || control::live_spine(robot) == 0) {
    return Refusal{"robot_fault", fmt::format("the Spine of '{}' is not alive", robot),
                   "its drives' watchdogs stop the robot; if it moves, cut its power"};
  }
  const ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry((*spine)->telemetry);
  wire::Telemetry now{};
  const std::int64_t deadline_ns = monotonic_ns() + kSeenWithinNs;
  while (monotonic_ns() < deadline_ns) {
    if (telemetry.latest(now) && now.mode == static_cast<std::uint32_t>(wire::Mode::estop)) {
      return Json{{"robot", robot}, {"mode", "estop"}, {"tick", now.tick}};
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return Refusal{"robot_fault", fmt::format("the Spine of '{}' has not obeyed the e-stop", robot), "cut its power"};
}

}  // namespace

int estop(const Context& context) {
  const std::vector<std::string> robots =
      context.robot.empty() ? ticking_robots() : std::vector<std::string>{context.robot};
  if (robots.empty()) {
    return refuse(context, {"no_robot", "no robot is ticking here", "if a robot moves, cut its power"});
  }
  // Nobody is asked which one was meant while robots move: all stop.
  Json stopped = Json::array();
  for (const std::string& robot : robots) {
    Answer answer = press(robot);
    if (std::holds_alternative<Refusal>(answer) && std::get<Refusal>(answer).code == "no_robot") {
      Context named = context;
      named.robot = robot;
      answer = ask(named, "estop", Json::object(), 1000);  // no right to write there: the supervisor has it
    }
    if (const auto* refusal = std::get_if<Refusal>(&answer)) {
      return refuse(context, *refusal);
    }
    stopped.push_back(std::get<Json>(answer));
  }
  Json result = stopped.front();
  if (stopped.size() > 1) {
    result["robots"] = stopped;
  }
  return finish(context, result, [&stopped](const Json&) {
    for (const Json& each : stopped) {
      print_command("estop", each);
    }
  });
}

}  // namespace lithe::cli
