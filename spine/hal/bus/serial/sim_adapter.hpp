// SPDX-License-Identifier: Apache-2.0
// The adapter between a host's serial line and the simulated devices of one bus: bytes in, bytes out.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "spine/hal/core/frame.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"

namespace lithe::hal::sim {

// Contract: never in the tick · one thread · time is an argument · nodes are attached before the first byte and outlive
// it
class SimAdapter {
 public:
  SimAdapter() = default;
  SimAdapter(const SimAdapter&) = delete;
  SimAdapter& operator=(const SimAdapter&) = delete;
  virtual ~SimAdapter() = default;

  void attach(BusNode& node) { nodes_.push_back(&node); }

  // Any bytes from the host, cut anywhere. What the adapter says to them is appended to `out`.
  virtual void feed(std::span<const char> bytes, std::int64_t now_ns, std::string& out) = 0;

  // Time passes: what the devices say by themselves is appended to `out`. About once a millisecond.
  virtual void idle(std::int64_t now_ns, std::string& out) = 0;

  // As after power came back: nothing half said remains, everything is configured as it left the factory.
  virtual void reset() = 0;

  // The wires are so bad that the adapter's controller gives up; or they are good again, and it stays as it is until it
  // is started anew, which is the host's business. Nothing passes a controller that is off.
  void spoil_wires(bool bad) {
    wires_bad_ = bad;
    off_ = off_ || bad;
  }

 protected:
  bool bus_off() const { return off_; }
  // The controller is started anew; on bad wires it does not last.
  void recover() { off_ = wires_bad_; }

  // One frame onto the bus; what the devices answer is in answers() until the next call.
  void to_bus(const Frame& frame, std::int64_t now_ns) {
    answers_.clear();
    if (off_) return;
    for (BusNode* node : nodes_) node->on_frame(frame, now_ns, answers_);
  }
  // The same without a frame.
  void time_to_bus(std::int64_t now_ns) {
    answers_.clear();
    for (BusNode* node : nodes_) node->on_time(now_ns, answers_);
    if (off_) answers_.clear();
  }
  FrameQueue& answers() { return answers_; }

 private:
  std::vector<BusNode*> nodes_;
  FrameQueue answers_;
  bool wires_bad_ = false;
  bool off_ = false;
};

}  // namespace lithe::hal::sim
