// SPDX-License-Identifier: Apache-2.0
// A robot's joints as hinges of an MJCF model, which MuJoCo moves. MuJoCo is looked for when such a plant is opened,
// and only then.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/physics/mechanism.hpp"
#include "spine/hal/physics/plant.hpp"

namespace lithe::hal::sim {

struct MujocoJoint {
  std::string name;  // of a hinge of the model
  double initial_position_rad = 0;
  double torque_lag_s = 0;
  double torque_max_nm = 1e9;  // of the motor, at the joint
};

struct MujocoParams {
  std::string model;                      // path of an MJCF file
  std::int64_t step_ns = Plant::kStepNs;  // of the physics; a multiple of Plant::kStepNs
  std::vector<MujocoJoint> joints;
};

using Clock = std::int64_t (*)();  // nanoseconds

// The model moves as MuJoCo says: its gravity, contacts, limits, friction, armature. Its own actuators are off: drives
// are the only ones. Where the physics takes longer steps than the drives, a joint moves evenly within one. Whatever
// else the model has (a free base, passive joints, things that lie about) moves too. A motion that grows beyond all
// bounds starts anew, as MuJoCo has it. Its step allocates nothing, except where meshes touch or more than 128 bodies
// may. The error names the joint or what MuJoCo says, that a step takes longer by this clock than it lasts, or how to
// install MuJoCo.
// Contract: never in the tick
Result<std::unique_ptr<Mechanism>> open_mujoco(const MujocoParams& params, Clock clock = monotonic_ns);

}  // namespace lithe::hal::sim
