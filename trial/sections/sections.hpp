// SPDX-License-Identifier: Apache-2.0
// The parts of a trial. Each stops at its deadline once its mandatory part is done, and says false when the law is
// refused.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "lithe/law.hpp"
#include "spine/core/result.hpp"
#include "trial/core/report.hpp"
#include "trial/core/trial_setup.hpp"
#include "trial/sections/law_harness.hpp"
#include "trial/sections/recording.hpp"

namespace lithe::trial {

// Contract: nothing in it allocates any more
struct TrialContext {
  const TrialSetup& setup;
  const LitheLaw& law;
  const Recording& recording;
  LawHarness& one;
  LawHarness& other;  // the same law at other addresses
  std::int64_t budget_ns;
  std::int64_t deadline_ns = 0;  // of the section that runs; not of the runs
  Report& report;
  std::vector<double> times_ns;  // room for kTimingInputs
  std::int64_t law_ns = 0;       // of the runs: what the law's own steps may take
  bool can_trap = false;         // SIGFPE is caught: it tells the place of an invalid operation

  std::uint32_t joints() const { return setup.joints(); }
  bool out_of_time() const { return setup.clock.now_ns() > deadline_ns; }
  Progress& progress() { return report.progress[report.section]; }

  // True when the two have given the same output in their last step.
  bool same_bits();
  // Stores what is being tested, for the message of a crash.
  __attribute__((format(printf, 2, 3))) void doing(const char* format, ...);
  // Always false.
  __attribute__((format(printf, 2, 3))) bool refuse(const char* format, ...);
  // Refuses when an output of `harness` is not a number, or it wrote where it must not.
  bool sound(LawHarness& harness);
  // Refuses when it wrote an entry of its Effort that belongs to no joint of this robot.
  bool within_joints(const LawHarness& harness);
};

inline constexpr std::size_t kTimingInputs = 1000;

// The inputs of a law that have an entry for each joint.
struct JointInput {
  const char* name;
  JointArray Tick::* values;
};
inline constexpr std::array kJointInputs =
    std::to_array<JointInput>({{"position_rad", &Tick::position_rad},
                               {"velocity_rad_s", &Tick::velocity_rad_s},
                               {"torque_nm", &Tick::torque_nm},
                               {"setpoint_position_rad", &Tick::setpoint_position_rad},
                               {"setpoint_velocity_rad_s", &Tick::setpoint_velocity_rad_s},
                               {"setpoint_acceleration_rad_s2", &Tick::setpoint_acceleration_rad_s2}});

// Whether entries of its inputs that belong to no joint of this robot leave its output alone; else refuses.
bool reads_within_joints(TrialContext& context);

bool run_benign(TrialContext& context);   // finite, the same twice, how much a lost state changes
bool run_loop(TrialContext& context);     // with the simulated robot and the guard
bool run_replay(TrialContext& context);   // on what this robot did in the last seconds
bool run_hostile(TrialContext& context);  // NaN, infinities, jumps, wrong times
bool run_timing(TrialContext& context);   // how long a step takes on this board

// Of a law that passed: a run that was cut short, and the joints that it brings no nearer to their setpoint than no
// law does, one sentence each.
std::vector<std::string> warnings(const Report& report, const TrialSetup& setup);

// What is wrong with the law's control, one sentence per joint, as far as the numbers of its runs show it: of the joint
// that it was refused for; of a law that passed, joints that stay away from their setpoint.
std::vector<std::string> hints(const Report& report, const TrialSetup& setup, bool passed);

// Opens the simulated robot, runs it until every drive is set up and on, and measures the baseline without a law. Then
// opens it again for the trials. Errors: it cannot be simulated, or a drive does not become ready.
Result<> prepare_runs(TrialSetup& setup);

}  // namespace lithe::trial
