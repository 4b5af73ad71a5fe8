// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/loop/loop_bus.hpp"

namespace lithe::hal {

void LoopBus::begin(std::int64_t now_ns) LITHE_RT {
  deliver();  // uncollected frames arrive in the time of the old exchange
  statistics_.late += inbound_.size();
  inbound_.clear();
  now_ns_ = now_ns;
  for (BusNode* node : nodes_) node->on_time(now_ns, inbound_);
  count_refused();
}

bool LoopBus::send(const Frame& frame) LITHE_RT {
  if (!outbound_.push(frame)) {
    count_refused();
    return false;
  }
  ++statistics_.sent;
  return true;
}

bool LoopBus::receive(Frame& frame) LITHE_RT {
  deliver();
  const Frame* next = inbound_.front();
  if (next == nullptr) return false;
  frame = *next;
  inbound_.pop();
  ++statistics_.received;
  return true;
}

void LoopBus::deliver() LITHE_RT {
  while (const Frame* frame = outbound_.front()) {
    for (BusNode* node : nodes_) node->on_frame(*frame, now_ns_, inbound_);
    outbound_.pop();  // removed after the nodes have read it
  }
  count_refused();
}

}  // namespace lithe::hal
