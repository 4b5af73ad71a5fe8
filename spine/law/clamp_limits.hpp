// SPDX-License-Identifier: Apache-2.0
// In how many ticks the guard may change a law's torque: one table for the trial and the probation. The other measures
// of both have one number each: shaking (tremor.hpp), the budget of a step, outputs that are not finite.
#pragma once

namespace lithe::law {

// A share of ticks. In a trial: of its run of a second, in which the setpoint moves gently and well within the limits,
// so what the guard does there is the law's doing. On probation the Brain's own setpoint may lead a good law to the
// limits of position and speed: there only a joint that is clamped nearly always counts, by whichever of the three.
// How fast the torque changes is the law's doing everywhere: the same number.
struct ClampLimit {
  double trial, probation;
};
inline constexpr double kClampedNearlyAlways = 0.8;
inline constexpr ClampLimit kPositionClampLimit{0.1, kClampedNearlyAlways};
inline constexpr ClampLimit kVelocityClampLimit{0.1, kClampedNearlyAlways};
inline constexpr ClampLimit kTorqueClampLimit{kClampedNearlyAlways, kClampedNearlyAlways};
inline constexpr ClampLimit kSlewClampLimit{0.25, 0.25};
// How long the slew is averaged on probation: as long as a trial's run. A large step of the setpoint changes the torque
// of a good law once, for less than a quarter of this.
inline constexpr double kSlewMemoryS = 1.0;

}  // namespace lithe::law
