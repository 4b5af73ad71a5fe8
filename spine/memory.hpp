// SPDX-License-Identifier: Apache-2.0
// The shared memory of a running robot, created by its Spine.
#pragma once

#include <string>

#include "spine/core/result.hpp"
#include "spine/ipc/frames.hpp"
#include "spine/ipc/segment.hpp"

namespace lithe {

// The segments of a running robot, its Spine lease, and a look at its supervisor's.
struct Memory {
  ipc::Lease lease;
  ipc::LeaseWatch supervisor;
  ipc::Segment<ipc::SpineMemory> spine;
  ipc::Segment<ipc::ControlMemory> control;
  ipc::Segment<ipc::BrainMemory> brain;
  ipc::Segment<ipc::FramesMemory> frames;
};

// Replaces segments that a crashed run left. Error: another Spine of this robot is running.
Result<Memory> make_memory(const std::string& robot);
void remove_memory(const std::string& robot);

}  // namespace lithe
