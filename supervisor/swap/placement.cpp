// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/placement.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <utility>

#include "spine/arena/arena.hpp"

namespace lithe::control {

Fd open_arena(const robot::RobotConfig& robot) {
  if (robot.spine.loader == robot::LawLoader::dlopen) return Fd();
  const pid_t pid = live_spine(robot.name).value_or(0);
  const Result<int> memory = pid != 0 ? arena::memory_of(pid) : arena::make_memory();
  if (!memory) {
    spdlog::warn("{}; laws are loaded with dlopen", memory.message());
    return Fd();
  }
  return Fd(*memory);
}

bool Placement::has_arena() const {
  const wire::RobotInfo& info = spine_.info();
  return lawd_can_place_ && info.arena_base == arena::kBase && info.arena_slots == arena::kSlots &&
         info.arena_slot_bytes == arena::kSlotBytes;
}

// A stage request that waits in the mailbox, or that the Loader is handling, names a slot that no LawInfo shows yet
// (models/placement.pml).
bool Placement::predecessors_requests_are_answered() {
  constexpr std::uint64_t kDepth = wire::control_segment::kStageDepth;
  for (std::uint64_t ticket = inherited_ > kDepth ? inherited_ - kDepth + 1 : 1; ticket <= inherited_; ++ticket)
    if (spine_.poll_stage(ticket) == wire::StageResult::pending) return false;
  inherited_ = 0;
  return true;
}

std::uint32_t Placement::free_slot() {
  if (!predecessors_requests_are_answered()) return 0;
  // Read the answers first: the Loader publishes a law before it answers the request.
  for (Use& use : uses_)
    if (use.state == Use::asked && spine_.poll_stage(use.ticket) != wire::StageResult::pending) use = {};
  std::array<bool, arena::kSlots + 1> resident{};
  for (const wire::LawInfo& law : spine_.laws())
    if (arena::is_slot(law.slot)) resident[law.slot] = true;
  for (std::uint32_t i = 0; i < arena::kSlots; ++i) {
    const std::uint32_t slot = 1 + (last_ + i) % arena::kSlots;
    if (!resident[slot] && uses_[slot].state == Use::free) return slot;
  }
  return 0;
}

void Placement::place(const std::string& hash, Callback callback, std::int64_t now_ns) {
  if (!has_arena()) return callback(Placed{});
  const std::uint32_t slot = free_slot();
  if (slot == 0) {
    return callback(Refusal{"slots_full", fmt::format("all {} slots of the code arena are in use", arena::kSlots),
                            "another swap is under way in the Spine; try again"});
  }
  last_ = slot;
  uses_[slot] = {Use::taken, 0};
  const auto take = [this, slot, callback = std::move(callback)](const std::variant<Placed, Refusal>& answer) {
    const auto* refusal = std::get_if<Refusal>(&answer);
    if (refusal == nullptr) return callback(answer);
    forget(slot);
    if (refusal->code != "arena_failed") return callback(answer);
    spdlog::warn("{}; laws are loaded with dlopen", refusal->message);
    lawd_can_place_ = false;
    callback(Placed{});
  };
  lawd_.place(hash, slot, take, now_ns);
}

}  // namespace lithe::control
