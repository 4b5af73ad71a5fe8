// SPDX-License-Identifier: Apache-2.0
// Couples simulated drives through one mechanism.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/physics/coupled_drive.hpp"
#include "spine/hal/physics/plant.hpp"

namespace lithe::hal::sim {

// Steps all its drives and the mechanism they move together, 50 us at a time: each drive decides on its torque, then
// all joints move. A drive measures what its joint did one such step later than one with a plant of its own. As a node
// on a bus it sends nothing: it is attached before the drives, and advances all of them to the time of a frame before
// any drive gets that frame. A CiA 402 drive checks its host's heartbeat only when its next frame comes, and continues
// its last command until then, like a drive that checks once per SYNC.
// Contract: RT · one thread · drives outlive it, and nothing else advances them beyond its time
class Coupling final : public BusNode {
 public:
  explicit Coupling(std::unique_ptr<Mechanism> mechanism) : mechanism_(std::move(mechanism)) {}

  // Attaches a drive to the mechanism's next joint, which moves its plant from now on. False: there is no such joint.
  // Contract: never in the tick
  bool add(CoupledDrive& drive);

  // Advances every drive to `now_ns`, before frames of that time reach any of them. Time that goes backwards is
  // ignored.
  void advance(std::int64_t now_ns) LITHE_RT;

  void to_start() LITHE_RT override {
    mechanism_->to_start();
    for (std::size_t i = 0; i < drives_.size(); ++i) follow(i);
  }

  void on_frame(const Frame& /*frame*/, std::int64_t now_ns, FrameQueue& /*answers*/) LITHE_RT override {
    advance(now_ns);
  }
  void on_time(std::int64_t now_ns, FrameQueue& /*answers*/) LITHE_RT override { advance(now_ns); }

  const Mechanism& mechanism() const LITHE_RT { return *mechanism_; }

 private:
  void step() LITHE_RT;
  void follow(std::size_t joint) LITHE_RT;

  std::unique_ptr<Mechanism> mechanism_;
  std::vector<CoupledDrive*> drives_;
  bool started_ = false;
  std::int64_t time_ns_ = 0;
};

}  // namespace lithe::hal::sim
