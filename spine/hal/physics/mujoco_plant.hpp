// SPDX-License-Identifier: Apache-2.0
// A robot's joints as hinges of an MJCF model, simulated by MuJoCo. The library is loaded only when such a plant is
// opened.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/physics/plant.hpp"

namespace lithe::hal::sim {

struct MujocoJoint {
  std::string name;  // of a hinge of the model
  double initial_position_rad = 0;
  double torque_lag_s = 0;
  double torque_max_nm = 1e9;                         // of the motor, at the joint
  double position_min_rad = 0, position_max_rad = 0;  // limits that the model's own range must contain
};

struct MujocoParams {
  std::string model;                      // path of an MJCF file
  std::int64_t step_ns = Plant::kStepNs;  // of the physics; a multiple of Plant::kStepNs
  std::vector<MujocoJoint> joints;
  bool imu = false;  // read_imu() gives its first sensors framequat, gyro and accelerometer, which must be there
};

using Clock = std::int64_t (*)();  // nanoseconds

// Gravity, contacts, limits, friction and armature are the model's. Its own actuators are off: only the drives act.
// When the physics step is longer than the drives' step, a joint's position is interpolated linearly. Other parts of
// the model (free base, passive joints, loose objects) move too. A diverging simulation is reset by MuJoCo. A step
// allocates only when meshes touch, or when more than 128 bodies may touch. The error names the joint, whose range in
// the model may be too narrow, or the sensors that an IMU lacks, or gives MuJoCo's text, or says that a step takes
// longer than it simulates, or how to install MuJoCo.
// Contract: never in the tick
Result<std::unique_ptr<Mechanism>> open_mujoco(const MujocoParams& params, Clock clock = monotonic_ns);

}  // namespace lithe::hal::sim
