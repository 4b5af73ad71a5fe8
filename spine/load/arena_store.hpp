// SPDX-License-Identifier: Apache-2.0
// Laws that lawd has linked for a slot of the arena and written there. The default back end: loading needs no mmap,
// mprotect or allocation in the process that ticks.
#pragma once

#include <array>

#include "spine/arena/arena.hpp"
#include "spine/load/law_store.hpp"

namespace lithe::load {

// Trusts nothing in a request: slot, size, entry, hash and every pointer of the descriptor are checked before any of
// the code runs.
// Contract: see LawStore · allocates nothing
class ArenaStore final : public LawStore {
 public:
  explicit ArenaStore(arena::Arena arena) : arena_(std::move(arena)) {}

  wire::StageResult load(std::uint32_t place, const wire::StageRequest& request, const LitheLaw*& law,
                         std::span<char> why) override;
  void unload(std::uint32_t place) override;

  const arena::Arena& arena() const { return arena_; }
  arena::Arena take_arena() { return std::move(arena_); }  // for another store

 private:
  bool in_use(std::uint32_t slot) const;

  arena::Arena arena_;
  std::array<std::uint32_t, law::kResidents> slots_{};  // arena slot of each resident; 0 = none
};

}  // namespace lithe::load
