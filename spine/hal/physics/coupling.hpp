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
#include "spine/hal/physics/mechanism.hpp"
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
  // Longest time that one advance() simulates; the rest is skipped, only watchdogs run.
  static constexpr std::int64_t kMaxCatchUpNs = 50'000'000;

  explicit Coupling(std::unique_ptr<Mechanism> mechanism) : mechanism_(std::move(mechanism)) {}

  // Attaches a drive to the mechanism's next joint. The drive has advance(now_ns), skip(now_ns) and plant(); the
  // mechanism moves its plant from now on. False: there is no such joint.
  // Contract: never in the tick
  template <class AnyServo>
  bool add(AnyServo& servo) {
    if (drives_.size() == mechanism_->joints()) return false;
    drives_.push_back(std::make_unique<DriveOf<AnyServo>>(servo));
    servo.plant().couple();
    follow(drives_.size() - 1);
    return true;
  }

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
  struct Drive {
    Drive() = default;
    Drive(const Drive&) = delete;
    Drive& operator=(const Drive&) = delete;
    virtual ~Drive() = default;
    virtual void advance(std::int64_t now_ns) LITHE_RT = 0;
    virtual void skip(std::int64_t now_ns) LITHE_RT = 0;
    virtual Plant& plant() LITHE_RT = 0;
  };
  template <class AnyServo>
  struct DriveOf final : Drive {
    explicit DriveOf(AnyServo& which) : servo(which) {}
    void advance(std::int64_t now_ns) LITHE_RT override { servo.advance(now_ns); }
    void skip(std::int64_t now_ns) LITHE_RT override { servo.skip(now_ns); }
    Plant& plant() LITHE_RT override { return servo.plant(); }
    AnyServo& servo;
  };

  void step() LITHE_RT;
  void follow(std::size_t joint) LITHE_RT;

  std::unique_ptr<Mechanism> mechanism_;
  std::vector<std::unique_ptr<Drive>> drives_;
  bool started_ = false;
  std::int64_t time_ns_ = 0;
};

}  // namespace lithe::hal::sim
