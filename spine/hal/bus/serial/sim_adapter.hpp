// SPDX-License-Identifier: Apache-2.0
// The adapter between a host's serial line and the simulated devices of one bus: bytes in, bytes out.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::sim {

// Contract: never in the tick · one thread · time is an argument · nodes are attached before the first byte and outlive
// it
class SimAdapter : public Interface {
 public:
  explicit SimAdapter(std::size_t longest_line) : longest_line_(longest_line) {}

  void attach(BusNode& node) { nodes_.push_back(&node); }

  // Any bytes from the host, in pieces of any size. The adapter's answers are appended to `out`.
  void feed(std::span<const char> bytes, std::int64_t now_ns, std::string& out) {
    for (const char c : bytes) {
      if (ends_line(c)) {
        line_.size() <= longest_line_ ? serve(line_, now_ns, out) : refuse(out);
        line_.clear();
      } else if (line_.size() <= longest_line_) {
        line_ += c;
      }
    }
  }

  // Advances time: frames that devices send by themselves are appended to `out`. Call about once a millisecond.
  virtual void idle(std::int64_t now_ns, std::string& out) = 0;

  // Power cycle: drops partial lines and restores the factory configuration.
  void reset() {
    line_.clear();
    restart();
    recover();
  }

  // Puts the controller in bus-off, or ends the cause. After that it stays in bus-off until the host restarts it. No
  // frame passes in bus-off.
  void set_bus_off(bool bad) {
    wires_bad_ = bad;
    off_ = off_ || bad;
  }

 protected:
  virtual bool ends_line(char c) const = 0;
  // A whole line, perhaps empty.
  virtual void serve(std::string_view line, std::int64_t now_ns, std::string& out) = 0;
  // Instead of a line that is longer than any command.
  virtual void refuse(std::string& /*out*/) const {}
  virtual void restart() = 0;

  bool bus_off() const { return off_; }
  // Restarts the controller; while the cause lasts, it goes bus-off again.
  void recover() { off_ = wires_bad_; }

  // Sends one frame to the devices; their answers are in answers() until the next call.
  void to_bus(const Frame& frame, std::int64_t now_ns) {
    answers_.clear();
    if (off_) return;
    for (BusNode* node : nodes_) node->on_frame(frame, now_ns, answers_);
  }
  // The same without a frame: only advances time.
  void time_to_bus(std::int64_t now_ns) {
    answers_.clear();
    for (BusNode* node : nodes_) node->on_time(now_ns, answers_);
    if (off_) answers_.clear();
  }
  FrameQueue& answers() { return answers_; }

 private:
  std::size_t longest_line_;
  std::string line_;  // so far; one byte more than the longest is too long
  std::vector<BusNode*> nodes_;
  FrameQueue answers_;
  bool wires_bad_ = false;
  bool off_ = false;
};

}  // namespace lithe::hal::sim
