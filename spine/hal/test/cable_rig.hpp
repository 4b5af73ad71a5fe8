// SPDX-License-Identifier: Apache-2.0
// For tests: a cable between a bus and one simulated drive, which a test may spoil.
#pragma once

#include <cstdint>
#include <functional>

#include "spine/hal/bus/loop/loop_bus.hpp"

namespace lithe::hal {

// What spoils frames is a test's own, and no part of what must be real-time.
#if defined(__clang__) && __clang_major__ >= 20
#pragma clang diagnostic push
#pragma clang diagnostic ignored "-Wfunction-effects"
#endif

// Every frame passes here on its way to the drive and back, and may be changed; false: it is lost.
template <class Sim>
class Cable final : public BusNode {
 public:
  template <class Params>
  explicit Cable(const Params& params) : drive_(params) {}

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override {
    Frame copy = frame;
    if (there && !there(copy)) return;
    drive_.on_frame(copy, now_ns, fresh_);
    forward(answers);
  }
  void on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT override {
    drive_.on_time(now_ns, fresh_);
    forward(answers);
  }

  std::function<bool(Frame&)> there, back;  // null: a sound cable
  Sim& drive() { return drive_; }

 private:
  void forward(FrameQueue& answers) {
    while (const Frame* answer = fresh_.front()) {
      Frame copy = *answer;
      fresh_.pop();
      if (!back || back(copy)) answers.push(copy);
    }
  }

  Sim drive_;
  FrameQueue fresh_;
};

#if defined(__clang__) && __clang_major__ >= 20
#pragma clang diagnostic pop
#endif

}  // namespace lithe::hal
