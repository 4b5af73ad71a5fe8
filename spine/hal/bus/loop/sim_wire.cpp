// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/loop/sim_wire.hpp"

#include <limits>

namespace lithe::hal::sim {

Frame SimWire::damaged(const Frame& frame) LITHE_RT {
  Frame broken = frame;
  if (frame.payload().empty() || !happens(faults_.corrupt)) return broken;
  const std::uint64_t bit = draws_.next() % (8 * frame.payload().size());
  broken.data[bit / 8] = static_cast<std::uint8_t>(broken.data[bit / 8] ^ 1U << bit % 8);
  return broken;
}

void SimWire::on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  if (!faults_.bus_off && !happens(faults_.drop)) {
    const Frame arrived = damaged(frame);
    const int times = happens(faults_.duplicate) ? 2 : 1;
    for (int i = 0; i < times; ++i) carry(arrived, now_ns);
    const Frame* old = told_before_.next(frame);
    if (old != nullptr && happens(faults_.replay)) carry(*old, now_ns);
  }
  come_back(now_ns, answers);
}

void SimWire::carry(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  for (BusNode* node : nodes_) node->on_frame(frame, now_ns, said_);
}

void SimWire::on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  for (BusNode* node : nodes_) node->on_time(now_ns, said_);
  come_back(now_ns, answers);
}

std::int64_t SimWire::next_due_ns() const LITHE_RT {
  return head_ == tail_ ? std::numeric_limits<std::int64_t>::max() : late_[tail_ % late_.size()].due_ns;
}

void SimWire::keep(const Late& late) LITHE_RT {
  if (head_ - tail_ < late_.size()) late_[head_++ % late_.size()] = late;
}

// In order, also when the delay changes: frames on a wire cannot overtake each other.
void SimWire::come_back(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  while (const Frame* frame = said_.front()) {
    if (!faults_.bus_off && !happens(faults_.drop)) {
      const int times = happens(faults_.duplicate) ? 2 : 1;
      for (int i = 0; i < times; ++i) keep({now_ns + faults_.delay_ns, damaged(*frame)});
      const Frame* old = said_before_.next(*frame);
      if (old != nullptr && happens(faults_.replay)) keep({now_ns + faults_.delay_ns, *old});
    }
    said_.pop();
  }
  if (faults_.bus_off) tail_ = head_;  // delayed frames are lost
  while (next_due_ns() <= now_ns && head_ != tail_ && answers.push(late_[tail_ % late_.size()].frame)) ++tail_;
}

}  // namespace lithe::hal::sim
