// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402_setpoint_limiter.hpp"

#include <gtest/gtest.h>

namespace lithe::hal::cia402 {
namespace {

TEST(Cia402SetpointLimiter, APositionBeyondAllNumbersDoesNotSpoilTheOnesAfterIt) {
  DriverParams params;
  params.mode = Mode::position;
  params.counts_per_rev = 1e9;
  params.joint.ratio = 1e4;
  SetpointLimiter limiter(params);
  limiter.rest(1000);
  JointCommand command;
  command.action = DriveAction::torque;
  command.target_rad = 1e300;
  for (int i = 0; i < 3; ++i) limiter.next(command, {});
  command.target_rad = 1e-4;
  RawSetpoint raw;
  for (int i = 0; i < 2000; ++i) raw = limiter.next(command, {});
  EXPECT_NEAR(static_cast<std::int32_t>(raw.target), params.joint.motor_rev(1e-4) * params.counts_per_rev, 1);
}

}  // namespace
}  // namespace lithe::hal::cia402
