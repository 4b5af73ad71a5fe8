// SPDX-License-Identifier: Apache-2.0
// The laws in a step: runs the active one, replaces one that fails, judges a new one, runs a shadow, commits the next.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "lithe/law.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/guard/guard.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/law/slot.hpp"
#include "spine/robot/config.hpp"
#include "spine/step/bumpless.hpp"
#include "spine/step/host.hpp"
#include "spine/step/judge/probation.hpp"
#include "spine/step/judge/watch.hpp"
#include "spine/step/mode.hpp"
#include "spine/step/report.hpp"
#include "spine/step/shadow.hpp"

namespace lithe::step {

// Where the joint is and what is allowed: ": 1.234 rad, allowed -1.200 to 1.200". Nothing for a fault without a number.
void tell_beyond(const robot::RobotConfig& robot, const Tick& in, std::size_t joint, wire::Fault fault,
                 EventText& words) LITHE_RT;

// Contract: RT · owned by the tick thread
class Laws {
 public:
  struct Wiring {
    const robot::RobotConfig& robot;
    law::Slot& slot;
    law::Sandbox& sandbox;  // the memory that a law may write
    const guard::Guard& guard;
    ModeMachine& mode;
    Tick& in;  // what a law sees in this tick
    const plan::Setpoint& planned;
    Report& report;
  };
  explicit Laws(const Wiring& wiring);

  // Runs the active law; its output is in effort() and `probes`. To be called before the guard. A law that fails is
  // replaced in the same tick by the law before it, or by the safe law if there is none.
  void step(Host& host, std::array<double, kMaxProbes>& probes) LITHE_RT;
  // To be called after the guard. A law on probation that does worse than the one before it is replaced from the next
  // tick on; so is one that turns bad later, as the robot file says.
  void check_probation(const guard::Verdict& verdict) LITHE_RT;
  // Afterwards: the law that runs from the next tick on must hold the joints where they are.
  bool holds_here() const LITHE_RT { return holds_here_; }
  // To be called at the end of the tick: commits a waiting law, which the next tick runs. In step.cpp.
  void swap(Host& host) LITHE_RT;

  // Before the law drives joints that it did not drive: State fields that are not finite are set to their defaults,
  // because the law's values for a stopped group are not checked; and a mark is taken off.
  void begin() LITHE_RT;
  // The law that would run has stopped the robot: a fault without a law to go back to, or it drove a joint out of its
  // limits. A joint that something else drove out, against the law's torque, is not the law's doing.
  bool marked() const LITHE_RT { return active() != nullptr && active()->marked; }
  // Commands, in listen.cpp. Sets all values in this tick, or, when one of them is refused, none.
  wire::CommandResult set_params(const wire::Command& command) LITHE_RT;
  // Reverts the last parameter change; a second call sets the new values again.
  wire::CommandResult revert_params(const wire::Command& command) LITHE_RT;
  // Back by `count` laws; 0 means 1.
  wire::CommandResult roll_back(const wire::Command& command) LITHE_RT;

  const law::Resident* active() const LITHE_RT { return slot_.active(); }
  std::uint32_t active_id() const LITHE_RT { return active() == nullptr ? 0 : active()->law_id; }
  const Effort& effort() const LITHE_RT { return effort_; }
  const wire::ShadowReport& shadow() const LITHE_RT { return shadow_.report(); }

 private:
  struct Run {
    contain::Failure failure;
    std::int64_t from_ns;
    std::int64_t took_ns = 0, budget_ns = 0;  // of one that failed
    std::size_t joint = kMaxJoints;           // whose output is not finite, and which one
    std::string_view output = "";
  };
  // A step back: to the previous parameters, or to the law before.
  enum class Back : std::uint8_t { nowhere, params, law };

  Run run(law::Resident& law, Effort& effort, Host& host) LITHE_RT;
  bool asked_into_soft_stop(std::uint32_t j, double torque_nm) const LITHE_RT;
  std::size_t not_finite_at(const Effort& effort) const LITHE_RT;
  bool fall_back(const Run& first, Host& host) LITHE_RT;
  void replace(const Probation::News& why) LITHE_RT;
  void stop(const Probation::News& why) LITHE_RT;
  void obey(const Watch::News& news) LITHE_RT;
  Back step_back() LITHE_RT;
  void begin_law(std::uint32_t blend_ticks) LITHE_RT;
  void stop_for(wire::LawFaultKind kind, std::string_view why) LITHE_RT;
  void mark(std::string_view why) LITHE_RT;
  bool drove_out(std::uint32_t j) const LITHE_RT;  // this and the next: in step.cpp
  void see_power() LITHE_RT;
  void commit(law::Resident& candidate, law::Carry carry) LITHE_RT;
  void start_shadow(law::Resident& candidate) LITHE_RT;
  void step_shadow(Host& host) LITHE_RT;
  void end_shadow(Shadow::Opinion opinion, std::string_view why) LITHE_RT;
  wire::CommandResult params_set(const wire::Command& command, std::uint32_t count, std::string_view text) LITHE_RT;

  void tell_not_carried(const law::Resident& law, law::FieldBits fields) LITHE_RT;
  void tell_back(Back back, std::string_view why) LITHE_RT;
  void tell_probation(const Probation::News& news) LITHE_RT;
  EventText in_words(const Probation::News& news) const LITHE_RT;
  EventText in_words(const Run& failed) const LITHE_RT;
  void tell_inputs(std::size_t joint, EventText& words) const LITHE_RT;
  void tell_clamped(const Probation::Evidence& evidence, EventText& words) const LITHE_RT;
  wire::LawFault fault_of(const contain::Failure& failure) const LITHE_RT;
  void report(wire::LawFault& fault, std::uint32_t to_law_id, std::int64_t took_ns, std::string_view why) LITHE_RT;

  const robot::RobotConfig& robot_;
  law::Slot& slot_;
  law::Sandbox& sandbox_;
  const guard::Guard& guard_;
  ModeMachine& mode_;
  Tick& in_;
  const plan::Setpoint& planned_;
  Report& report_;
  std::int64_t period_ns_;
  std::int64_t budget_ns_;  // for a law without a budget of its own
  Bumpless bumpless_;
  Probation probation_;
  Watch watch_;
  bool holds_here_ = false;
  Shadow shadow_;
  Effort effort_;
  double forget_power_ = 0;  // per tick
  JointArray power_w_{};     // that the law recently gave to the joint; below 0: it braked
};

}  // namespace lithe::step
