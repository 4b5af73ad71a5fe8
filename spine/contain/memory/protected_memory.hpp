// SPDX-License-Identifier: Apache-2.0
// ProtectedMemory: memory of this process that a law cannot write.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <utility>

#include "spine/contain/memory/memory_key.hpp"
#include "spine/core/mapping.hpp"
#include "spine/core/pinned.hpp"
#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"

namespace lithe::contain {

enum class Protection : std::uint8_t {
  best,    // keys if the machine has them, otherwise copies
  keys,    // pages a law cannot write: the attempt is a fault with its address
  copies,  // guarded blocks are copied before each call, compared and put back after it
};

inline constexpr std::size_t kMaxGuardedBlocks = 8;

// Memory that a law must write (its state, effort, probes) stays outside; memory that it reads may be inside. Thread
// stacks, thread-local variables and the C library's data cannot be inside: a law's stray write there is not detected.
// Contract: made once, before the threads that use it (they inherit the write permission) · lives as long as they do ·
// allocate() and guard() off the tick, one thread at a time · the rest RT
class ProtectedMemory : Pinned {
 public:
  // `bytes` of prefaulted memory, locked where the limit allows it.
  static Result<std::unique_ptr<ProtectedMemory>> make(std::size_t bytes, Protection wanted = Protection::best);
  ~ProtectedMemory();

  // Zeroed memory for the life of the protected memory; nullptr when it is full.
  void* allocate(std::size_t bytes, std::size_t alignment = 64);

  // An object in the protected memory; nullptr when it is full. Its destructor is the caller's (std::destroy_at).
  template <class T, class... Args>
  T* create(Args&&... args) {
    void* place = allocate(sizeof(T), alignof(T) < 64 ? 64 : alignof(T));
    return place == nullptr ? nullptr : ::new (place) T(std::forward<Args>(args)...);
  }

  // Without keys: these bytes are copied around every call (8 bytes cost about 1/2 ns). Only for blocks of one thread,
  // registered with FaultBarrier::guard. With keys they must be in the protected memory, and nothing is copied.
  Result<> guard(void* block, std::size_t bytes);

  // Gives write permission to the calling thread, which was started before the protected memory was made.
  void open_for_this_thread() const;

  Protection protection() const LITHE_RT { return key_ < 0 ? Protection::copies : Protection::keys; }
  int key() const LITHE_RT { return key_; }  // -1 = none

  // Called before and after each law. `check` restores changed blocks, and returns the first changed address (nullptr =
  // none).
  void remember() LITHE_RT {
    for (std::size_t i = 0; i < blocks_used_; ++i) remember(blocks_[i]);
  }
  const void* check() LITHE_RT {
    const void* broken = nullptr;
    for (std::size_t i = 0; i < blocks_used_; ++i)
      if (const void* at = check(blocks_[i])) broken = at;
    return broken;
  }

 private:
  // Two copies, so that a stray write into a copy is told from one into the block.
  struct Block {
    std::byte *original, *copy, *second;
    std::size_t bytes;
  };
  explicit ProtectedMemory(int key) : key_(key) {}
  static void remember(const Block& block) LITHE_RT;
  static const void* check(const Block& block) LITHE_RT;

  Mapping pages_;
  int key_;  // -1 = none
  std::size_t used_ = 0;
  std::array<Block, kMaxGuardedBlocks> blocks_{};
  std::size_t blocks_used_ = 0;
};

}  // namespace lithe::contain
