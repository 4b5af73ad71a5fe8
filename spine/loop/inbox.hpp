// SPDX-License-Identifier: Apache-2.0
// The tick's inputs from other processes: commands, the e-stop, plans, the Brain's heartbeat.
#pragma once

#include <atomic>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::loop {

// Every byte it reads may be hostile. Its outputs are bounded; their values are checked by the caller.
// Contract: RT · owned by the tick thread · every call bounded
class Inbox {
 public:
  // `supervised`: whether a supervisor lives, as another thread saw it last; null = none does.
  Inbox(ipc::SpineMemory& spine, const ipc::ControlMemory& control, const ipc::BrainMemory& brain,
        const std::atomic<bool>* supervised);
  Inbox(const Inbox&) = delete;
  Inbox& operator=(const Inbox&) = delete;

  // The next command; null = none. It is valid until the next call, and must be answered before that.
  const wire::Command* next_command() LITHE_RT;
  bool is_from_brain() const LITHE_RT { return from_ == &brain_; }
  void answer(wire::CommandResult result) LITHE_RT { from_->answer(ticket_, static_cast<std::uint32_t>(result)); }

  // True while any sticky e-stop word is set.
  bool estop_pressed() const LITHE_RT;

  // True if a new plan has arrived; plan() holds the Spine's own copy of it.
  bool new_plan() LITHE_RT;
  wire::Plan& plan() LITHE_RT { return plan_; }
  // True if the last new_plan() gave up: a plan is there, but four reads were all torn.
  bool plan_torn() const LITHE_RT { return plan_torn_; }

  // The Spine's own copy of new inputs to the law; null: none came. A torn one counts as none: the next is soon there.
  const wire::Inputs* new_inputs() LITHE_RT { return input_reader_.read(inputs_) ? &inputs_ : nullptr; }

  bool supervised() const LITHE_RT;

  // Age of the Brain's last heartbeat [ns]; -1 before the first. A heartbeat with a time in the future is ignored.
  std::int64_t brain_age_ns(std::int64_t now_ns) const LITHE_RT;

 private:
  // Counts of invalid input, published in shared memory.
  void tell() LITHE_RT;

  using Receiver = ipc::MailboxReceiver<wire::Command, wire::control_segment::kCommandsDepth>;
  const ipc::ControlMemory* control_memory_;
  const ipc::BrainMemory* brain_memory_;
  const std::atomic<bool>* supervised_;
  Receiver control_;
  Receiver brain_;
  ipc::ChannelReader<wire::Plan> plan_reader_;
  ipc::ChannelReader<wire::Inputs> input_reader_;
  wire::Health told_{};
  ipc::HealthMemory* health_;
  wire::Command command_{};
  Receiver* from_ = &control_;  // the last command
  std::uint64_t ticket_ = 0;    // likewise
  wire::Plan plan_{};
  wire::Inputs inputs_{};
  bool plan_torn_ = false;
};

}  // namespace lithe::loop
