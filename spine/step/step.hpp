// SPDX-License-Identifier: Apache-2.0
// One control step: a sample, a plan and a command in; a command to the drives, a record and events out. No clock, no
// shared memory, no bus: the same inputs give the same outputs, bit for bit.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "lithe/law.hpp"
#include "spine/core/rt.hpp"
#include "spine/guard/guard.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/law/slot.hpp"
#include "spine/plan/interpolator.hpp"
#include "spine/robot/config.hpp"
#include "spine/step/drives.hpp"
#include "spine/step/host.hpp"
#include "spine/step/laws.hpp"
#include "spine/step/mode.hpp"
#include "spine/step/report.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::step {

// All inputs of a step, except the answers of its Host and the laws in the Slot.
struct Input {
  std::uint64_t tick;
  std::int64_t now_ns;               // CLOCK_MONOTONIC: the time of this step
  const hal::ActuatorState& sample;  // x_k: the newest sample, fresh or not
  bool exchanged = true;             // u_k was handed over in this tick; `sample` has the replies to u_{k-1}
  bool deadline_missed = false;      // the tick before ended late, or releases were skipped
  bool estop_pressed = false;        // one of the sticky words is set
  std::int64_t brain_age_ns = -1;    // since the Brain's last heartbeat; -1 = none so far
  const wire::Command* command = nullptr;
  bool untried = false;                  // the command's parameters skipped the trial although there is one
  const wire::Plan* plan = nullptr;      // a new one
  bool plan_torn = false;                // there is a plan, but it was not read complete
  const wire::Inputs* inputs = nullptr;  // new ones
  const char* damaged = nullptr;         // name of constant memory that was changed; null: none
};

// The interpolator, the mode, the laws and the guard, in the order of the timing figure.
// Contract: run() RT, on one thread · made off the tick
class ControlStep {
 public:
  // The arguments must outlive this object. Laws run in `sandbox`.
  ControlStep(const robot::RobotConfig& robot, law::Slot& slot, law::Sandbox& sandbox);
  ControlStep(const ControlStep&) = delete;
  ControlStep& operator=(const ControlStep&) = delete;

  // Output: `command` is u_{k+1}; `record` is this tick's telemetry, except for release, durations and counters, which
  // the loop fills in. `record` is also an input: its counter late_samples is increased, not set. The report is valid
  // until the next call.
  const Report& run(const Input& in, Host& host, hal::ActuatorCommand& command, wire::Telemetry& record) LITHE_RT;

  wire::Mode mode() const LITHE_RT { return mode_.mode(); }
  const Laws& laws() const LITHE_RT { return laws_; }
  const Tick& seen() const LITHE_RT { return in_; }  // what a law sees in this tick

  // Memory that no law may change: the guard and the mode.
  std::array<std::span<std::byte>, 2> guarded() {
    return {std::as_writable_bytes(std::span(&guard_, 1)), std::as_writable_bytes(std::span(&mode_, 1))};
  }

 private:
  void count_exchange(const Input& in, wire::Telemetry& record) LITHE_RT;
  void look(const Input& in) LITHE_RT;
  guard::Verdict check(const Input& in, JointCommands& out) LITHE_RT;
  void react(const guard::Verdict& verdict) LITHE_RT;
  void name(const guard::Group& group, EventText& words) const LITHE_RT;
  void name(wire::Fault fault, EventText& words) const LITHE_RT;
  void name(const wire::PlanDecision& decided, EventText& words) const LITHE_RT;
  void fill(const Input& in, wire::Telemetry& record) const LITHE_RT;

  // listen.cpp
  void listen(const Input& in) LITHE_RT;
  void watch_memory(const char* damaged) LITHE_RT;
  void obey(const Input& in) LITHE_RT;
  wire::CommandResult execute(const Input& in) LITHE_RT;
  wire::CommandResult change_mode(wire::CommandKind kind, const Input& in) LITHE_RT;
  wire::CommandResult reset_simulation(const wire::Command& command) LITHE_RT;
  Conditions conditions(const Input& in) const LITHE_RT;
  bool moves(const Input& in) const LITHE_RT;
  void switch_off_at_rest(const Input& in) LITHE_RT;
  void hold_here(const Input& in) LITHE_RT;
  void watch_brain(const Input& in) LITHE_RT;
  void take_plan(const wire::Plan& plan) LITHE_RT;
  void answer(const wire::Plan& plan, const wire::PlanDecision& decided) LITHE_RT;
  void miss_plan() LITHE_RT;
  void take_inputs(const wire::Inputs& inputs) LITHE_RT;
  void refuse_inputs(double value, const EventText& why) LITHE_RT;
  void fail(wire::Fault fault, std::string_view text) LITHE_RT;

  const robot::RobotConfig& robot_;
  plan::Interpolator plan_;
  guard::Guard guard_;
  ModeMachine mode_;
  Drives drives_;
  Report report_;
  Tick in_;
  Laws laws_;

  std::uint32_t stale_ticks_ = 0;  // ticks in a row without a fresh sample
  bool recovered_ = false;         // in mode recover: all joints are inside their limits
  bool memory_whole_ = true;
  bool brain_stale_ = true;
  std::int64_t inputs_ns_ = 0;  // when the last came; 0 = none yet
  bool inputs_refused_ = false;
  wire::Plan resting_plan_;  // a plan, with the joints that are stopped at rest

  // Of a `disarm` or `reset` that came while a joint moved.
  struct {
    std::uint64_t request_id = 0;
    std::uint64_t ticks = 0, ticks_at_rest = 0;
    wire::EventKind event = wire::EventKind::disarmed;
  } braking_;
};

}  // namespace lithe::step
