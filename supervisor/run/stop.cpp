// SPDX-License-Identifier: Apache-2.0
// Shutdown: switches the drives off, ends the children, removes files and segments.
#include <fmt/format.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>

#include "spine/core/time.hpp"
#include "supervisor/run/supervisor.hpp"

namespace lithe::control {

void Supervisor::stop() {
  stopping_ = true;
  bool known_off = true;
  // A Spine that we could not adopt is left running.
  if (spine_ && !spine_->ended() && (link_ || !adopted_)) known_off = stop_spine();
  if (swaps_) swaps_->write_last_certificates(monotonic_ns());
  if (incidents_) incidents_->finish(*link_);
  if (server_) {
    server_->flush(200);
    server_.reset();
  }
  lawd_.stop();
  trial_.stop();
  if (owns_files_) {
    const bool in_folder = has_pid_file();  // else the files there may be another supervisor's
    if (in_folder) ::unlinkat(run_.get(), (config_.name + ".pid").c_str(), 0);
    if (remove_segments(config_.name) && in_folder) ::unlinkat(run_.get(), (config_.name + kValuesEnding).c_str(), 0);
  }
  if (!known_off) {
    wire::Telemetry last{};
    const std::string joints = link_ && link_->latest(last) ? joints_not_off(config_, last) : "";
    throw Halt{3, fmt::format("not confirmed that every drive of '{}' is off{}; the drives' own watchdogs stop them; "
                              "if the robot moves, cut its power",
                              config_.name, joints.empty() ? "" : fmt::format(" (last seen on: {})", joints))};
  }
}

bool Supervisor::stop_spine() {
  Drives drives = Drives::driven;
  if (link_) (void)code_of([&] { drives = switch_off(); });
  spine_->signal(SIGTERM);
  const std::int64_t deadline_ns = monotonic_ns() + 5 * kNsPerS;
  while (!spine_->wait(20) && monotonic_ns() < deadline_ns) forward_spine_log();
  // An adopted Spine is not our child, so its exit code is unknown.
  const int adopted_code = adopted_ && link_ && link_->confirmed_off().value_or(false) ? 0 : 1;
  const bool in_order = spine_->ended() && spine_->exit_code().value_or(adopted_code) == 0;
  if (!spine_->ended()) {
    spdlog::error("the Spine did not stop within 5 s: killed; the drives' watchdogs switch off");
    spine_->signal(SIGKILL);
    spine_->wait(2000);
  }
  forward_spine_log();
  spdlog::info("robot '{}' stopped; Spine: {}", config_.name, spine_->verdict());
  // The Spine's final command is "off". That is enough when the drives answered just before and were only damped (as
  // after an e-stop), or were never switched on.
  return drives == Drives::off || (in_order && (drives == Drives::damped || !link_));
}

Drives Supervisor::switch_off() {
  const Refusal stopping{"stopping", "the robot is being stopped", "start it again: lithe run"};
  const auto refuse_swaps = [&] {
    if (swaps_) swaps_->refuse_all(stopping, monotonic_ns());
  };
  refuse_swaps();
  commands_->close(stopping);  // or a client could arm the robot again while its drives go off
  bool answered = false;
  bool obeyed = false;
  wire::Command disarm;
  disarm.kind = static_cast<std::uint32_t>(wire::CommandKind::disarm);
  commands_->send(
      disarm,
      [&](const Answer& answer) {
        const auto* refusal = std::get_if<Refusal>(&answer);
        answered = true;
        obeyed = refusal == nullptr || refusal->code == "refused_estop";
      },
      monotonic_ns());
  turn_until([&] { return answered || spine_->ended(); }, Commands::kTimeoutNs + Commands::kBrakingNs);
  wire::Telemetry now{};
  Drives seen = Drives::driven;
  if (obeyed) {
    const bool pressed = link_->latest(now) && now.mode == static_cast<std::uint32_t>(wire::Mode::estop);
    const Drives wanted = pressed ? Drives::damped : Drives::off;
    const auto wait_over = [&] {
      seen = link_->latest(now) ? drives_of(now) : Drives::driven;
      return seen >= wanted || spine_->ended();
    };
    turn_until(wait_over, 2 * kNsPerS);
  }
  refuse_swaps();  // requests may have arrived in between
  commands_->refuse_all(stopping);
  return seen;  // one record with all drives off is enough: a later one may miss a late sample
}

namespace {

// An unknown number, and `enabling`, in which a motor may already turn, count as driven.
Drives drive_of(const wire::Telemetry& now, std::size_t joint) {
  if ((now.joint_status[joint] & wire::joint_status::kFresh) == 0) return Drives::driven;
  switch (static_cast<wire::DriveState>(now.drive_state[joint])) {
    case wire::DriveState::off:
    case wire::DriveState::fault:
      return Drives::off;
    case wire::DriveState::damped:
      return Drives::damped;
    case wire::DriveState::enabling:
    case wire::DriveState::driven:
      break;
  }
  return Drives::driven;
}

std::size_t joints_of(const wire::Telemetry& now) { return std::min<std::size_t>(now.joint_count, wire::kNj); }

}  // namespace

Drives drives_of(const wire::Telemetry& now) {
  Drives least = joints_of(now) == 0 ? Drives::driven : Drives::off;
  for (std::size_t j = 0; j < joints_of(now); ++j) least = std::min(least, drive_of(now, j));
  return least;
}

std::string joints_not_off(const robot::RobotConfig& robot, const wire::Telemetry& now) {
  std::string names;
  for (std::size_t j = 0; j < std::min(joints_of(now), robot.joints.size()); ++j)
    if (drive_of(now, j) != Drives::off) names += (names.empty() ? "" : ", ") + robot.joints[j].name;
  return names;
}

}  // namespace lithe::control
