// SPDX-License-Identifier: Apache-2.0
// The Spine: all state of the tick. The tick itself is in tick.cpp, its work with laws in laws.cpp, its handling of
// commands and plans in spine.cpp.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string_view>

#include "lithe/law.hpp"
#include "spine/contain/cell.hpp"
#include "spine/contain/constants.hpp"
#include "spine/core/rt.hpp"
#include "spine/guard/guard.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/law/slot.hpp"
#include "spine/loop/bumpless.hpp"
#include "spine/loop/clock.hpp"
#include "spine/loop/handover.hpp"
#include "spine/loop/inbox.hpp"
#include "spine/loop/mode.hpp"
#include "spine/loop/probation.hpp"
#include "spine/loop/publish.hpp"
#include "spine/loop/release.hpp"
#include "spine/loop/shadow.hpp"
#include "spine/plan/interpolator.hpp"
#include "spine/robot/config.hpp"

namespace lithe::loop {

// The parts that the Spine uses; all of them outlive the Spine.
struct Wiring {
  const robot::RobotConfig& robot;
  ipc::SpineMemory& spine;
  const ipc::ControlMemory& control;
  const ipc::BrainMemory& brain;
  law::Slot& slot;
  law::Sandbox& sandbox;  // the memory that a law may write
  contain::Cell* cell;    // of the tick thread; null: a crash of a law ends the process
  Handover& handover;
  const ClockMemory& clock;
  hal::Actuators* inline_actuators;               // set when the tick thread serves the buses itself, else null
  const contain::Constants* constants = nullptr;  // memory that must not change; null = not checked
};

// Contract: constructed off the tick · run() and tick() on the tick thread only
class Spine {
 public:
  explicit Spine(const Wiring& wiring);

  // Ticks at the robot's rate until `stop`, then switches the drives off. False: the Transport was too busy to send
  // this to all.
  bool run(const std::atomic<bool>& stop) noexcept;

  // One tick: woken at `woke_ns` for the release at `release_ns`; `skipped` releases were missed before it.
  void tick(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT;

  // Without a Transport thread: does the bus exchange now. Otherwise does nothing.
  void serve_inline() LITHE_RT;

  wire::Mode mode() const LITHE_RT { return mode_.mode(); }

 private:
  void exchange(std::int64_t woke_ns) LITHE_RT;
  void listen(std::int64_t now_ns) LITHE_RT;
  void watch_memory(std::int64_t now_ns) LITHE_RT;
  void obey(const CommandTicket& letter, std::int64_t now_ns) LITHE_RT;
  wire::CommandResult execute(const wire::Command& command, std::int64_t now_ns) LITHE_RT;
  wire::CommandResult change_mode(wire::CommandKind kind, std::uint64_t request_id, std::int64_t now_ns) LITHE_RT;
  Conditions conditions() const LITHE_RT;
  wire::CommandResult reset_simulation(const wire::Command& command, std::int64_t now_ns) LITHE_RT;
  wire::CommandResult set_params(const wire::Command& command, std::int64_t now_ns) LITHE_RT;
  void watch_params(std::uint64_t request_id) LITHE_RT;
  wire::CommandResult revert_params(const wire::Command& command, std::int64_t now_ns) LITHE_RT;
  wire::CommandResult roll_back(const wire::Command& command, std::int64_t now_ns) LITHE_RT;
  void watch_brain(std::int64_t now_ns) LITHE_RT;
  void take_plan(std::int64_t now_ns) LITHE_RT;
  void miss_plan(std::int64_t now_ns) LITHE_RT;
  void look(std::int64_t now_ns) LITHE_RT;
  guard::Verdict check(std::int64_t now_ns) LITHE_RT;
  void react(const guard::Verdict& verdict, std::int64_t now_ns) LITHE_RT;
  void forget_stopped_joints() LITHE_RT;
  void name(const guard::Group& group, Words& words) const LITHE_RT;
  hal::DriveAction action_of(std::uint32_t joint) const LITHE_RT;
  void compose() LITHE_RT;
  void publish(const guard::Verdict& verdict, std::int64_t release_ns) LITHE_RT;
  void step_law(std::int64_t now_ns) LITHE_RT;
  contain::Trouble run_law(law::Resident& law, Effort& effort) LITHE_RT;
  bool fall_back(const contain::Trouble& first, std::int64_t now_ns) LITHE_RT;
  void replace_law(wire::LawFaultKind why, std::int64_t now_ns) LITHE_RT;
  bool resume_previous() LITHE_RT;
  void tell_not_carried(const law::Resident& law, law::FieldBits fields, std::int64_t now_ns) LITHE_RT;
  Words in_words(wire::LawFaultKind why) const LITHE_RT;
  void mend_law(std::int64_t now_ns) LITHE_RT;
  void tell_rollback(wire::LawFaultKind why, std::int64_t now_ns) LITHE_RT;
  void stop_for_law(wire::LawFaultKind kind, std::int64_t now_ns) LITHE_RT;
  wire::LawFault fault_of(const contain::Trouble& trouble, std::int64_t now_ns) const LITHE_RT;
  void report(wire::LawFault& fault, std::uint32_t to_law_id, std::int64_t took_ns) LITHE_RT;
  void judge_law(const guard::Verdict& verdict, std::int64_t now_ns) LITHE_RT;
  void tell_probation(const Probation::News& news, std::int64_t now_ns) LITHE_RT;
  void name_evidence(const Probation::News& news) LITHE_RT;
  void swap(std::int64_t now_ns) LITHE_RT;
  void commit(law::Resident& candidate, law::Carry carry, std::int64_t now_ns) LITHE_RT;
  void start_shadow(law::Resident& candidate, std::int64_t now_ns) LITHE_RT;
  void step_shadow(std::int64_t now_ns) LITHE_RT;
  void end_shadow(bool promoted, std::string_view why, std::int64_t now_ns) LITHE_RT;
  void greet_law(std::uint32_t blend_ticks) LITHE_RT;
  void count_release(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT;
  bool stop_drives() noexcept;

  const robot::RobotConfig& robot_;
  law::Slot& slot_;
  law::Sandbox& sandbox_;
  contain::Cell* cell_;
  const contain::Constants* constants_;
  Handover& handover_;
  hal::Actuators* inline_actuators_;
  SteeredClock clock_;
  ReleaseGrid grid_;
  Inbox inbox_;
  Publisher out_;
  plan::Interpolator plan_;
  guard::Guard guard_;
  ModeMachine mode_;
  Bumpless bumpless_;
  Probation probation_;
  std::uint64_t params_request_id_ = 0;  // of the command whose parameters are on probation
  bool params_went_ = false;             // the last step back reverted parameters; false: a law
  Words why_;                            // details of the last replacement
  Shadow shadow_;

  std::uint32_t joints_;
  std::int64_t period_ns_;
  std::uint32_t slowest_;      // ticks until every drive has been asked
  std::uint64_t state_ticks_;  // between two publications of the law's State
  bool simulated_;             // every bus is
  std::int64_t budget_ns_;     // for a law without a budget of its own
  std::uint64_t tick_ = 0;
  const hal::ActuatorState* sample_;    // x_k: the newest sample, fresh or not
  bool fresh_ = false;                  // it is from the exchange of the previous release
  std::uint32_t stale_ticks_ = 0;       // ticks in a row without a fresh sample
  std::uint32_t clear_ticks_left_ = 0;  // since the last reset
  bool reset_simulation_ = false;       // with the next command
  bool recovered_ = false;              // in mode recover: all joints are inside their limits
  bool all_off_ = true;                 // the next command is "off" for all drives
  std::uint64_t ticks_off_ = 0;         // such commands sent in a row
  bool estop_pressed_ = false;
  bool memory_whole_ = true;
  bool brain_stale_ = true;
  std::int64_t law_from_ns_ = 0;  // when the last law began to step
  std::uint32_t flags_ = 0;       // of this tick's record
  bool overran_ = false;          // the previous tick ended after its deadline
  Durations durations_;
  std::int64_t last_from_ns_ = 0, served_ns_ = 0;  // inline Transport: start of the last tick, and of its bus exchange
  Tick in_;
  Effort effort_;           // the law's output
  JointArray wanted_nm_{};  // the resulting torque at each joint
  Effort shadow_effort_;    // the shadow candidate's output
  std::array<double, kMaxProbes> probes_{};
  plan::Setpoint setpoint_;
  JointArray planned_rad_{};  // the plan's setpoint position, also of stopped joints
  guard::Output output_;
};

}  // namespace lithe::loop
