// SPDX-License-Identifier: Apache-2.0
// The adapter between a host's serial line and the simulated devices of one bus: bytes in, bytes out.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "spine/hal/bus/frame.hpp"
#include "spine/hal/bus/loop_bus.hpp"

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

 protected:
  // One frame onto the bus; what the devices answer is in answers() until the next call.
  void to_bus(const Frame& frame, std::int64_t now_ns) {
    answers_.clear();
    for (BusNode* node : nodes_) node->on_frame(frame, now_ns, answers_);
  }
  // The same without a frame.
  void time_to_bus(std::int64_t now_ns) {
    answers_.clear();
    for (BusNode* node : nodes_) node->on_time(now_ns, answers_);
  }
  FrameQueue& answers() { return answers_; }

 private:
  std::vector<BusNode*> nodes_;
  FrameQueue answers_;
};

}  // namespace lithe::hal::sim
