// SPDX-License-Identifier: Apache-2.0
// `lithe move` and `lithe jog`: this process acts as the robot's Brain while one joint moves to its target.
#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "spine/core/time.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/robot/read/report.hpp"
#include "spine/robot/robot.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/robot/motion.hpp"
#include "supervisor/link/client/client.hpp"
#include "supervisor/link/spine/commands.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::cli {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;
using Brain = ipc::Segment<ipc::BrainMemory>;

constexpr auto kLookEvery = std::chrono::milliseconds(5);  // and a heartbeat each time
constexpr std::int64_t kSettleNs = kNsPerS;

// The Spine's telemetry, read by the Brain.
struct View {
  explicit View(Spine memory)
      : spine(std::move(memory)),
        telemetry(spine->telemetry),
        decisions(spine->plan_decisions),
        info_reader(spine->robot_info) {}
  Spine spine;
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry;
  ipc::RingReader<wire::PlanDecision, wire::spine_segment::kPlanDecisionsDepth> decisions;
  ipc::ChannelReader<wire::RobotInfo> info_reader;
};

// Refused for on_stale = "safe_stop": such a robot would stop at the end of every move.
void must_not_stop(const std::string& name, const wire::RobotInfo& info) {
  const auto robot = robot::load_robot(control::text_of(info.config_path));
  if (!robot || robot->brain.on_stale != robot::StaleAction::safe_stop) return;
  throw Refusal{"refused_brain",
                fmt::format("robot '{}' is armed only while a Brain lives ([brain] on_stale = \"safe_stop\"); this "
                            "command is one that leaves when the joint is there, and the robot would stop",
                            name),
                "move it from Python, which stays: robot = lithe.connect(); robot.arm() (after a stop robot.reset() "
                "first); robot.go_to(...); or set on_stale = \"hold\""};
}

// Waits until the joint has arrived at the target, and sends heartbeats.
void follow(View& view, const Brain& brain, const Move& move, const wire::RobotInfo& info, wire::Telemetry& now) {
  const wire::Plan& plan = move.plan;
  const std::int64_t until_ns = plan.t_ns[0] + kSettleNs;
  bool ended = false;
  while (monotonic_ns() < until_ns) {
    std::atomic_ref<std::int64_t>(brain->header.heartbeat_ns).store(monotonic_ns(), std::memory_order_release);
    for (wire::PlanDecision decided; view.decisions.next(decided);) {
      const auto why = static_cast<wire::PlanReject>(decided.reject);
      if (decided.plan_id != plan.plan_id || why == wire::PlanReject::none || why == wire::PlanReject::mode) continue;
      throw Refusal{"refused_plan", fmt::format("the Spine refuses the move: {}", control::text_of(decided.text)),
                    decided.needs_s > 0
                        ? fmt::format("more time: --in {:.2f}s, or a smaller angle", decided.needs_s + 0.01)
                        : "a smaller angle"};
    }
    (void)view.telemetry.latest(now);
    if (now.mode != static_cast<std::uint32_t>(wire::Mode::active)) {
      throw Refusal{
          "refused_mode",
          fmt::format("the move was ended: the robot is in mode {}, fault {}",
                      to_string(static_cast<wire::Mode>(now.mode)), to_string(static_cast<wire::Fault>(now.fault))),
          "see why: lithe status, lithe events"};
    }
    const bool rests = now.plan_state == static_cast<std::uint32_t>(wire::PlanState::hold);
    ended = now.plan_id == plan.plan_id && rests && monotonic_ns() > plan.t_ns[0];
    if (ended && has_arrived(move, now.position_rad[move.joint])) return;
    std::this_thread::sleep_for(kLookEvery);
  }
  if (ended) throw not_arrived(move, info, now);
  throw Refusal{"timeout", "the Spine has not come to the end of the move in time", "see what it does: lithe status"};
}

Json go(const std::string& robot, const Motion& motion) {
  auto memory = Spine::attach(robot, ipc::Access::read);
  if (!memory || !ipc::Lease::is_held(Spine::path(robot))) {
    value_of(control::reach(robot));  // says why
    throw Refusal{"robot_fault", memory ? "its Spine is not alive" : memory.message(), "see: lithe list"};
  }
  View view(std::move(*memory));
  wire::RobotInfo info{};
  wire::Telemetry now{};
  if (!view.info_reader.read(info) || !view.telemetry.latest(now))
    throw Refusal{"not_ready", fmt::format("robot '{}' has not ticked yet", robot), "try again in a moment"};
  auto lease = ipc::Lease::try_take(Brain::path(robot));
  const auto brain = Brain::attach(robot, ipc::Access::write);
  if (!lease || !brain)
    throw Refusal{"no_right", lease ? brain.message() : lease.message(), "run it as the robot's owner"};
  if (!lease->has_value()) {
    throw Refusal{"refused_brain",
                  fmt::format("robot '{}' has a Brain already (pid {}): two would pull it to and fro", robot,
                              (*brain)->header.writer_pid),
                  "end that one first, or let it make the move"};
  }
  must_not_stop(robot, info);
  const Move move = value_of(plan_motion(motion, info, now, monotonic_ns()));
  ipc::sign_in((*brain)->header, monotonic_ns());
  ipc::ChannelWriter<wire::Plan>((*brain)->plan).write(move.plan);
  follow(view, *brain, move, info, now);
  return Json{{"robot", robot},
              {"joint", motion.joint},
              {"from_rad", move.from_rad},
              {"to_rad", move.to_rad},
              {"position_rad", now.position_rad[move.joint]},
              {"tick", now.tick}};
}

}  // namespace

int move(const Context& context, const Motion& motion) {
  return finish(context, go(which_robot(context), motion), [](const Json& done) {
    fmt::print("{}: from {:.2f} to {:.2f} deg; it is at {:.2f} deg\n", done["joint"].get<std::string>(),
               done["from_rad"].get<double>() * kDegPerRad, done["to_rad"].get<double>() * kDegPerRad,
               done["position_rad"].get<double>() * kDegPerRad);
  });
}

namespace {

using control::Refusal;

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

// What a law without an integral part may leave: a tenth of the way, at least 1 deg.
double allowance_rad(const Move& move) { return std::max(0.1 * std::abs(move.to_rad - move.from_rad), 1 / kDegPerRad); }

}  // namespace

bool has_arrived(const Move& move, double position_rad) {
  const double missing_rad = move.to_rad - position_rad;
  const double lag_rad = move.from_rad - move.at_rad;  // that the law left already before the move
  return std::min(std::abs(missing_rad), std::abs(missing_rad - lag_rad)) <= allowance_rad(move);
}

Refusal not_arrived(const Move& move, const wire::RobotInfo& info, const wire::Telemetry& now) {
  const std::size_t j = move.joint;
  const double torque_nm = now.command_torque_nm[j], most_nm = info.torque_max_nm[j];
  return {
      "not_arrived",
      fmt::format("{} has not arrived: it is at {:.2f} deg, its target is {:.2f} deg (allowed: {:.2f} deg); it moves "
                  "at {:.2f} deg/s, and its drive is asked for {:.3f} N m of {:g} N m",
                  control::joint_name(info, j), now.position_rad[j] * kDegPerRad, move.to_rad * kDegPerRad,
                  allowance_rad(move) * kDegPerRad, now.velocity_rad_s[j] * kDegPerRad, torque_nm, most_nm),
      std::abs(torque_nm) > 0.9 * most_nm
          ? "its torque is at the limit: look for a stop or a load, or move back: lithe move"
          : "look for a stop or a load, or give the law more stiffness (lithe param get); or move back: lithe move"};
}

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
  move.at_rad = now.position_rad[move.joint];
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
