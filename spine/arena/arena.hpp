// SPDX-License-Identifier: Apache-2.0
// The memory of the arena, and the two ways to see it: read+execute where laws run, read+write where they are placed.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>

#include "spine/arena/layout.hpp"
#include "spine/core/mapping.hpp"
#include "spine/core/result.hpp"

namespace lithe::arena {

// A new arena, all slots empty: a file descriptor that is closed on exec. Its size can never change.
Result<int> make_memory();

// True when this descriptor is an arena made by make_memory().
bool is_memory(int fd);

// The arena of a running Spine, readable and writable: for a supervisor that adopts it. The Spine keeps its own
// descriptor as number kHandedFd.
Result<int> memory_of(pid_t pid);

// Replaces a descriptor by a read-only one: no mapping of it can ever be writable.
Result<> make_read_only(int fd);

// All slots, read+execute at their fixed address, and the stubs of this process below them. Every page is present when
// attach_exec() returns, and the mapping never changes afterwards.
// Contract: attach before the first tick; one per process · its contents change when a Writer places a law
class Arena {
 public:
  // The caller keeps `fd`. The Error says what the system refuses; laws are then loaded with dlopen.
  static Result<Arena> attach_exec(int fd);

  // Locks the pages in memory. No effect after mlockall.
  Result<> lock() const;

  // The bytes of a slot; is_slot(slot) must be true.
  std::span<const std::byte> slot(std::uint32_t slot) const {
    return {code_.bytes() + (slot_address(slot) - kBase), kSlotBytes};
  }

 private:
  Arena(Mapping stubs, Mapping code) : stubs_(std::move(stubs)), code_(std::move(code)) {}
  Mapping stubs_, code_;
};

// The only writer of code. Child processes do not inherit its mapping.
// Contract: one thread · one Writer per arena
class Writer {
 public:
  static Result<Writer> attach(int fd);

  // Puts an image into a slot that no process is running, and clears the rest of it. False: no such slot, or too large.
  bool place(std::uint32_t slot, std::span<const std::byte> image);

 private:
  Writer(Mapping view, Arena exec) : view_(std::move(view)), exec_(std::move(exec)) {}
  Mapping view_;
  Arena exec_;  // at the address where the code will run: caches are kept by address
};

}  // namespace lithe::arena
