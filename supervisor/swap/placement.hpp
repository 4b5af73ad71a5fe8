// SPDX-License-Identifier: Apache-2.0
// Chooses the arena slot of the next law, and tracks which slots are still in use.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "spine/arena/layout.hpp"
#include "spine/core/host/fd.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/link/services/services.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// The code arena of this robot: that of a live Spine, else a new one. Empty, with a warning in the log, when laws must
// be loaded with dlopen.
Fd open_arena(const robot::RobotConfig& robot);

// A slot is free when no law in the Spine uses it, lawd is not writing to it, and the Loader has answered every request
// that names it. This includes requests of an earlier supervisor: their slots are unknown, so all of them must be
// answered first.
// Contract: one thread · never blocks · every place() is answered once
class Placement {
 public:
  using Callback = LawdLink::PlacedCallback;

  Placement(SpineLink& spine, LawdLink& lawd) : spine_(spine), lawd_(lawd), inherited_(spine.last_stage_ticket()) {}

  // Lets lawd link the law of this hash for a free slot and write it there. The slot is reserved for the caller until
  // asked() or forget().
  void place(const std::string& hash, Callback callback, std::int64_t now_ns);
  void asked(std::uint32_t slot, std::uint64_t ticket) { uses_[slot] = {Use::asked, ticket}; }
  void forget(std::uint32_t slot) { uses_[slot] = {}; }

  // 0 when all are in use.
  std::uint32_t free_slot();

 private:
  struct Use {
    enum { free, taken, asked } state = free;
    std::uint64_t ticket = 0;
  };

  bool has_arena() const;
  bool predecessors_requests_are_answered();

  SpineLink& spine_;
  LawdLink& lawd_;
  std::uint64_t inherited_;  // the last request of an earlier supervisor; 0 once all of them are answered
  bool lawd_can_place_ = true;
  std::array<Use, arena::kSlots + 1> uses_{};  // by slot; [0] is not used
  std::uint32_t last_ = 0;                     // slots are used in turn, so the newest replaced law stays longest
};

}  // namespace lithe::control
