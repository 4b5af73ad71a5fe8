// SPDX-License-Identifier: Apache-2.0
// The two back ends for the code of laws: the arena, or dlopen.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "lithe/law.hpp"
#include "spine/arena/arena.hpp"
#include "spine/core/pinned.hpp"
#include "spine/law/resident.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::load {

// Contract: Loader thread only · never in the tick · a failed load leaves the index empty
class LawStore : public Interface {
 public:
  // Loads the requested code at an empty index (0..law::kResidents-1), with all symbols resolved and all pages touched.
  // Any result but `staged` has one sentence in `why`. The Loader checks the descriptor.
  virtual wire::StageResult load(std::uint32_t index, const wire::StageRequest& request, const LitheLaw*& law,
                                 std::span<char> why) = 0;

  // Frees the index. No thread may still run its code.
  virtual void unload(std::uint32_t index) = 0;
};

// Laws that lawd has linked for a slot of the arena and written there. The default back end: loading needs no mmap,
// mprotect or allocation in the process that ticks. Trusts nothing in a request: slot, size, entry, hash and every
// pointer of the descriptor are checked before any of the code runs.
// Contract: see LawStore · allocates nothing
class ArenaStore final : public LawStore {
 public:
  explicit ArenaStore(arena::Arena arena) : arena_(std::move(arena)) {}

  wire::StageResult load(std::uint32_t index, const wire::StageRequest& request, const LitheLaw*& law,
                         std::span<char> why) override;
  void unload(std::uint32_t index) override;

  const arena::Arena& arena() const { return arena_; }
  arena::Arena take_arena() { return std::move(arena_); }  // for another store

 private:
  bool in_use(std::uint32_t slot) const;

  arena::Arena arena_;
  std::array<std::uint32_t, law::kResidents> slots_{};  // arena slot of each resident; 0 = none
};

// Why the file at `path` must not be given to dlopen: not a regular file, not an ELF shared object of this machine, or
// truncated (the linker would map past its end, and the process would get SIGBUS). nullptr when it may.
// Contract: off the tick · allocates nothing · any bytes are safe
const char* check_object(const char* path);

// Laws as shared objects, through the dynamic linker.
// Contract: see LawStore · allocates nothing but what dlopen does itself
class DlopenStore final : public LawStore {
 public:
  ~DlopenStore() override;
  wire::StageResult load(std::uint32_t index, const wire::StageRequest& request, const LitheLaw*& law,
                         std::span<char> why) override;
  void unload(std::uint32_t index) override;

 private:
  const LitheLaw* open(std::uint32_t index, const char* path, std::span<char> why);

  std::array<void*, law::kResidents> handles_{};
};

}  // namespace lithe::load
