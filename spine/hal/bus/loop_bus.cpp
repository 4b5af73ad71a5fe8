// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/loop_bus.hpp"

namespace lithe::hal {

bool LoopBus::send(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  ++statistics_.sent;
  bool room = true;
  for (FarEnd* device : devices_) {
    Frame& reply = replies_[(first_ + count_) % kDepth];
    if (count_ == kDepth) {
      Frame lost;
      if (device->serve(frame, lost, now_ns)) {
        ++statistics_.dropped;
        room = false;
      }
    } else if (device->serve(frame, reply, now_ns)) {
      ++count_;
    }
  }
  return room;
}

bool LoopBus::receive(Frame& frame) LITHE_RT {
  if (count_ == 0) return false;
  frame = replies_[first_];
  first_ = (first_ + 1) % kDepth;
  --count_;
  ++statistics_.received;
  return true;
}

}  // namespace lithe::hal
