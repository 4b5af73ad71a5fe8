// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/inbox.hpp"

namespace lithe::loop {
namespace {

std::int64_t age_ns(const wire::SegmentHeader& header, std::int64_t now_ns) LITHE_RT {
  constexpr std::int64_t kFutureNs = 100'000'000;  // the tick may have been paused since it read its clock
  std::int64_t& word = const_cast<std::int64_t&>(header.heartbeat_ns);
  const std::int64_t heartbeat_ns = std::atomic_ref<std::int64_t>(word).load(std::memory_order_acquire);
  if (heartbeat_ns <= 0 || heartbeat_ns > now_ns + kFutureNs) return -1;
  return heartbeat_ns < now_ns ? now_ns - heartbeat_ns : 0;
}

}  // namespace

Inbox::Inbox(ipc::SpineMemory& spine, const ipc::ControlMemory& control, const ipc::BrainMemory& brain,
             const std::atomic<bool>* supervised)
    : control_memory_(&control),
      brain_memory_(&brain),
      supervised_(supervised),
      control_(control.commands, spine.control_ack),
      brain_(brain.commands, spine.brain_ack),
      plan_reader_(brain.plan),
      input_reader_(brain.inputs),
      health_(&spine.health) {}

const wire::Command* Inbox::next_command() LITHE_RT {
  for (Receiver* sender : {&control_, &brain_}) {
    if (!sender->receive(command_, ticket_)) continue;
    from_ = sender;
    return &command_;
  }
  return nullptr;
}

bool Inbox::new_plan() LITHE_RT {
  const std::uint64_t torn_before = plan_reader_.failures();
  const bool is_new = plan_reader_.read(plan_);
  plan_torn_ = plan_reader_.failures() != torn_before;
  tell();
  return is_new;
}

void Inbox::tell() LITHE_RT {
  const auto tell_one = [](std::uint64_t count, std::uint64_t& told, std::uint64_t& shared) LITHE_RT {
    if (count == told) return;
    told = count;
    ipc::store_word(shared, count, std::memory_order_relaxed);
  };
  tell_one(plan_reader_.failures(), told_.plans_torn, health_->plans_torn);
  tell_one(brain_.violations(), told_.brain_violations, health_->brain_violations);
  tell_one(control_.violations(), told_.control_violations, health_->control_violations);
}

bool Inbox::estop_pressed() const LITHE_RT {
  return ipc::load_word(control_memory_->estop.value, std::memory_order_acquire) != 0 ||
         ipc::load_word(brain_memory_->estop.value, std::memory_order_acquire) != 0;
}

bool Inbox::supervised() const LITHE_RT {
  // relaxed, with the store of the thread that looks: nothing else is read after it
  return supervised_ != nullptr && supervised_->load(std::memory_order_relaxed);
}

std::int64_t Inbox::brain_age_ns(std::int64_t now_ns) const LITHE_RT { return age_ns(brain_memory_->header, now_ns); }

}  // namespace lithe::loop
