// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/inbox.hpp"

namespace lithe::loop {

Inbox::Inbox(ipc::SpineMemory& spine, const ipc::ControlMemory& control, const ipc::BrainMemory& brain)
    : control_memory_(&control),
      brain_memory_(&brain),
      control_(control.commands, spine.control_ack),
      brain_(brain.commands, spine.brain_ack),
      plan_reader_(brain.plan) {}

std::optional<Letter> Inbox::next_command() LITHE_RT {
  Letter letter;
  if (control_.receive(command_, letter.ticket)) {
    letter.sender = Sender::control;
    return letter;
  }
  if (brain_.receive(command_, letter.ticket)) {
    letter.sender = Sender::brain;
    return letter;
  }
  return std::nullopt;
}

void Inbox::answer(const Letter& letter, wire::CommandResult result) LITHE_RT {
  Receiver& receiver = letter.sender == Sender::control ? control_ : brain_;
  receiver.answer(letter.ticket, static_cast<std::uint32_t>(result));
}

bool Inbox::estop_pressed() const LITHE_RT {
  return ipc::load_word(control_memory_->estop.value, std::memory_order_acquire) != 0 ||
         ipc::load_word(brain_memory_->estop.value, std::memory_order_acquire) != 0;
}

std::int64_t Inbox::brain_age_ns(std::int64_t now_ns) const LITHE_RT {
  constexpr std::int64_t kFutureNs = 1'000'000;  // two cores' clocks differ by far less
  std::int64_t& word = const_cast<std::int64_t&>(brain_memory_->header.heartbeat_ns);
  const std::int64_t beat_ns = std::atomic_ref<std::int64_t>(word).load(std::memory_order_acquire);
  if (beat_ns <= 0 || beat_ns > now_ns + kFutureNs) return -1;
  return beat_ns < now_ns ? now_ns - beat_ns : 0;
}

}  // namespace lithe::loop
