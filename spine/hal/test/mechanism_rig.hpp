// SPDX-License-Identifier: Apache-2.0
// A simulated robot whose joints hang on each other, as the loop sees it.
#pragma once

#include <gtest/gtest.h>

#include <cstdio>
#include <memory>
#include <string>

#include "spine/core/test/emulation_rig.hpp"
#include "spine/core/test/units_rig.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {

// One tick at a time, on a clock that only cycle() turns.
struct Robot {
  explicit Robot(const robot::RobotConfig& config) {
    Result<std::unique_ptr<Actuators>> opened = sim::open_actuators(config);
    std::remove(config.plant.model.c_str());
    why = opened ? "" : opened.message();
    if (!opened) return;
    actuators = std::move(*opened);
    command.joints = static_cast<std::uint32_t>(config.joints.size());
    command.position_rad.fill(kNan);
    command.max_torque_nm.fill(9);
  }
  void cycle(int times = 1) {
    for (int i = 0; i < times; ++i) {
      ++command.tick;
      actuators->cycle(command, state, now_ns);
      now_ns += 1'000'000;
    }
  }
  // Off until every drive is set up, then torque until all of them drive.
  void arm() {
    cycle(400);
    command.action.fill(DriveAction::torque);
    cycle(100);
    for (std::size_t i = 0; i < command.joints; ++i)
      EXPECT_EQ(state.status[i] & 0xff & ~wire::joint_status::kNotHomed, wire::joint_status::kFresh) << i;
  }
  ActuatorCommand command;
  ActuatorState state;
  std::int64_t now_ns = 5'000'000'000;
  std::unique_ptr<Actuators> actuators;
  std::string why;
};

// Skips the test where there is no MuJoCo.
// An emulated MuJoCo may be slower than the model's own time, which is refused as on any machine.
#define NEED_MUJOCO(robot)                                                                      \
  if ((robot).why.find("libmujoco-dev") != std::string::npos) GTEST_SKIP() << (robot).why;      \
  if (lithe::test::is_emulated() && (robot).why.find("it cannot keep up") != std::string::npos) \
  GTEST_SKIP() << "an emulator is too slow for this model's steps"

}  // namespace lithe::hal
