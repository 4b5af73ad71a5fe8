// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/robot/motion.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/time.hpp"
#include "spine/robot/read/report.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::cli {
namespace {

using control::Refusal;

constexpr double kDegPerRad = 180.0 / std::numbers::pi;
constexpr double kLeastS = 0.1, kMostS = 10.0;  // spine/plan/check.hpp: no waypoint is further away
constexpr double kFastest = 1.5;                // of the mean speed of a cubic from rest to rest

std::optional<Refusal> wrong_mode(const wire::Telemetry& now) {
  const auto mode = static_cast<wire::Mode>(now.mode);
  if (mode == wire::Mode::active) return std::nullopt;
  const bool latched = mode == wire::Mode::estop || mode == wire::Mode::safe_stop;
  return Refusal{"refused_mode",
                 fmt::format("a robot in mode {} follows no plan{}", to_string(mode),
                             latched ? fmt::format(" (fault {})", to_string(static_cast<wire::Fault>(now.fault))) : ""),
                 latched ? "find out why (lithe status), then: lithe reset, lithe arm" : "lithe arm, then again"};
}

std::variant<std::size_t, Refusal> joint_named(const std::string& name, const wire::RobotInfo& info) {
  std::vector<std::string> names;
  for (std::size_t j = 0; j < std::min<std::size_t>(info.joint_count, wire::kNj); ++j) {
    names.push_back(control::joint_name(info, j));
    if (names.back() == name) return j;
  }
  return Refusal{"unknown_joint",
                 fmt::format("there is no joint '{}'{}", name,
                             robot::suggestion(name, std::vector<std::string_view>(names.begin(), names.end()))),
                 "see them all: lithe status"};
}

std::optional<Refusal> beyond(const Motion& motion, const Move& move, const wire::RobotInfo& info) {
  const double least = info.position_min_rad[move.joint], most = info.position_max_rad[move.joint];
  if (!(move.to_rad >= least && move.to_rad <= most)) {
    return Refusal{"refused_range",
                   fmt::format("{} to {:.2f} deg: its limits are {:.2f} to {:.2f} deg", motion.joint,
                               move.to_rad * kDegPerRad, least * kDegPerRad, most * kDegPerRad),
                   "an angle between them"};
  }
  const double way_rad = std::abs(move.to_rad - move.from_rad), limit_rad_s = info.velocity_max_rad_s[move.joint];
  const double needs_rad_s = kFastest * way_rad / motion.in_s;
  if (needs_rad_s <= limit_rad_s) return std::nullopt;
  const double least_s = std::ceil(10.5 * kFastest * way_rad / limit_rad_s) / 10;
  return Refusal{
      "refused_range",
      fmt::format("{} by {:.2f} deg in {:g} s needs {:.1f} deg/s on the way: its limit is {:.1f} deg/s", motion.joint,
                  way_rad * kDegPerRad, motion.in_s, needs_rad_s * kDegPerRad, limit_rad_s * kDegPerRad),
      least_s <= kMostS ? fmt::format("more time: --in {:g}s", least_s) : "in two moves"};
}

}  // namespace

std::variant<Move, Refusal> plan_motion(const Motion& motion, const wire::RobotInfo& info, const wire::Telemetry& now,
                                        std::int64_t now_ns) {
  if (auto refused = wrong_mode(now)) return *refused;
  if (!(motion.in_s >= kLeastS && motion.in_s <= kMostS)) {
    return Refusal{"usage", fmt::format("--in {:g}s: a move takes {:g} to {:g} s", motion.in_s, kLeastS, kMostS),
                   "lithe move JOINT DEG --in 2s"};
  }
  const auto joint = joint_named(motion.joint, info);
  if (const auto* refusal = std::get_if<Refusal>(&joint)) return *refusal;
  Move move;
  move.joint = std::get<std::size_t>(joint);
  move.from_rad = now.setpoint_position_rad[move.joint];
  move.to_rad = motion.angle_deg / kDegPerRad + (motion.relative ? move.from_rad : 0.0);
  if (auto refused = beyond(motion, move, info)) return *refused;
  wire::Plan& plan = move.plan;
  plan.plan_id = static_cast<std::uint64_t>(now_ns);  // grows from one process to the next, as Python's does
  plan.waypoint_count = 1;
  plan.joint_count = info.joint_count;
  plan.t_ns[0] = now_ns + std::llround(motion.in_s * 1e9);
  plan.velocity_rad_s.fill(std::numeric_limits<double>::quiet_NaN());
  for (std::size_t j = 0; j < std::min<std::size_t>(info.joint_count, wire::kNj); ++j) {
    const double at_rad = now.setpoint_position_rad[j];
    plan.position_rad[j] =
        j == move.joint ? move.to_rad : std::clamp(at_rad, info.position_min_rad[j], info.position_max_rad[j]);
  }
  return move;
}

}  // namespace lithe::cli
