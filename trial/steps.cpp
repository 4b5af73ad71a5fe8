// SPDX-License-Identifier: Apache-2.0
#include "trial/steps.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "spine/robot/robot.hpp"

namespace lithe::trial {
namespace {

using nlohmann::json;
using Kind = law::Tremor::Finding::Kind;

constexpr double kLeastSeconds = 0.1, kMostSeconds = 60, kMostTicks = 1000;
constexpr double kMostSeed = 0x1p53;  // the whole numbers that every reader of JSON keeps

json refuse(const std::string& reason) { return {{"ok", false}, {"reason", reason}}; }

// The number at `key`, or `otherwise` where there is none. Error: it is no number, or not from `least` to `most`.
Result<double> number(const json& request, const char* key, double otherwise, double least, double most) {
  const auto found = request.find(key);
  if (found == request.end()) return otherwise;
  const double value = found->is_number() ? found->get<double>() : std::nan("");
  if (value >= least && value <= most) return value;
  return Error{fmt::format("\"{}\" must be a number from {:g} to {:g}, not {}", key, least, most, found->dump())};
}

json list(const std::array<double, wire::kNj>& values, std::size_t joints) {
  return std::vector<double>(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(joints));
}

std::uint32_t clamped(const LoopStats& stats) {
  return stats.torque_clamped + stats.slew_clamped + stats.position_clamped + stats.velocity_clamped;
}

}  // namespace

Result<std::unique_ptr<Steps>> Steps::make(const std::string& robot_path) {
  auto robot = robot::load_robot(robot_path);
  if (!robot) return robot.error();
  const auto real = std::ranges::find_if(robot->buses, robot::is_real);
  if (real != robot->buses.end()) {
    return Error{
        fmt::format("{}: bus {} is a real one, and what the joints behind it are would only be assumed: copy the file, "
                    "write kind = \"loop\" for each bus, and describe each joint in [joint.sim]",
                    robot_path, real->name)};
  }
  robot->guard.soft_start_s = 0;  // as in a trial
  return std::unique_ptr<Steps>(new Steps(std::move(*robot)));
}

Steps::Steps(robot::RobotConfig robot) : robot_(std::move(robot)), plain_(robot_) {
  plain_.plant.ideal = true;
  start_inside(plain_);
  heavy_ = with_payload(plain_);
}

json Steps::answer(const std::string& line) {
  const json request = json::parse(line, nullptr, false);
  const auto verb = request.is_object() ? request.find("verb") : request.end();
  const auto is = [&](const char* word) { return verb != request.end() && *verb == word; };
  if (is("describe")) return describe();
  if (is("reset")) return reset(request);
  if (is("step")) return step(request);
  return refuse("one JSON object per line, with \"verb\": describe, reset or step; a number is finite");
}

json Steps::describe() const {
  json joints = json::array();
  for (const robot::JointConfig& joint : robot_.joints)
    joints.push_back({{"name", joint.name}, {"torque_max_nm", joint.torque_max_nm}});
  return {{"ok", true}, {"robot", robot_.name}, {"rate_hz", robot_.rate_hz}, {"joints", joints}};
}

json Steps::reset(const json& request) {
  const auto seed = number(request, "seed", 0, 0, kMostSeed);
  const auto ticks = number(request, "ticks", 1, 1, kMostTicks);
  const auto seconds = number(request, "seconds", kRunSeconds, kLeastSeconds, kMostSeconds);
  for (const auto* each : {&seed, &ticks, &seconds})
    if (!*each) return refuse(each->message());
  const auto found = request.find("rough");
  if (found != request.end() && !found->is_boolean()) return refuse("\"rough\" must be true or false");
  const bool rough = found != request.end() && found->get<bool>();
  run_.reset();
  if (const auto opened = open_ready(rough ? heavy_ : plain_, simulated_); !opened) return refuse(opened.message());
  run_.emplace(robot_, simulated_, rough, Variation{static_cast<std::uint64_t>(*seed), *seconds});
  ticks_ = static_cast<std::uint32_t>(*ticks);
  end_ = run_->ticks_in(*seconds);
  held_ = {};
  return advance(1);  // in which it is armed
}

json Steps::step(const json& request) {
  if (!run_) return refuse("no episode has begun: reset first");
  if (over()) return refuse("the episode is over: reset first");
  const auto given = request.find("torque_nm");
  const std::size_t joints = robot_.joints.size();
  if (given == request.end() || !given->is_array() || given->size() != joints ||
      !std::ranges::all_of(*given, [](const json& each) { return each.is_number(); })) {
    return refuse(
        fmt::format("step needs \"torque_nm\": a list of {} numbers, one per joint of {}", joints, robot_.name));
  }
  for (std::size_t j = 0; j < joints; ++j) held_.torque_nm[j] = (*given)[j].get<double>();
  return advance(ticks_);
}

json Steps::advance(std::uint32_t ticks) {
  const LoopStats& stats = run_->stats;
  const std::uint32_t clamped_before = clamped(stats);
  for (std::uint32_t i = 0; i < ticks && !over(); ++i) run_->tick(held_);
  const wire::Telemetry& record = run_->record();
  const std::size_t joints = robot_.joints.size();
  std::string shakes;
  if (stats.tremor != 0) {
    const bool chatters = stats.tremor == static_cast<std::uint32_t>(Kind::chatter);
    shakes = fmt::format("{}: joint {}", chatters ? "chatter" : "oscillation", robot_.joints[stats.tremor_joint].name);
  }
  return {{"ok", true},
          {"tick", stats.ticks},
          {"over", over()},
          {"ended", stats.fault == 0 ? "" : fault_words(robot_, stats).data()},
          {"shakes", shakes},
          {"clamped", clamped(stats) != clamped_before},
          {"position_rad", list(record.position_rad, joints)},
          {"velocity_rad_s", list(record.velocity_rad_s, joints)},
          {"setpoint_position_rad", list(record.setpoint_position_rad, joints)},
          {"setpoint_velocity_rad_s", list(record.setpoint_velocity_rad_s, joints)},
          {"setpoint_acceleration_rad_s2", list(record.setpoint_acceleration_rad_s2, joints)},
          {"command_torque_nm", list(record.command_torque_nm, joints)}};
}

}  // namespace lithe::trial
