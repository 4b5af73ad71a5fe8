// SPDX-License-Identifier: Apache-2.0
// The latest value: one writer, many readers, nobody waits, and a writer may die in the middle.
#pragma once

#include <array>
#include <cstdint>

#include "spine/ipc/words.hpp"

namespace lithe::ipc {

// Four slots and an index, as it lies in shared memory. Value c lies in slot c & 3, so a reader of the latest value is
// disturbed only by a writer that gets three values ahead while it copies.
template <Payload T>
struct ChannelMemory {
  struct alignas(kLine) Slot {
    Record<T> record;
  };
  alignas(kLine) std::uint64_t latest;  // count of the newest whole value; 0 = none yet
  std::array<Slot, 4> slots;
};

// Contract: RT · exactly one per channel (the segment's lease sees to that) · write wait-free
template <Payload T>
class ChannelWriter {
 public:
  explicit ChannelWriter(ChannelMemory<T>& memory) : memory_(&memory) {}

  // A restarted writer goes on from `latest`: a slot its predecessor left odd is simply written over in its turn.
  void write(const T& value) LITHE_RT {
    const std::uint64_t count = load_word(memory_->latest, std::memory_order_relaxed) + 1;
    memory_->slots[count & 3].record.write(count, value, kAll);
    // release, with the acquire load in read(): the record's even sequence is visible before its number.
    store_word(memory_->latest, count, std::memory_order_release);
  }

 private:
  static constexpr wire::WordRanges kAll = all_words<T>();
  ChannelMemory<T>* memory_;
};

// Contract: RT · any number, each with a cursor of its own · read bounded: four tries, then the caller's copy stays
template <Payload T>
class ChannelReader {
 public:
  static constexpr int kTries = 4;

  explicit ChannelReader(const ChannelMemory<T>& memory) : memory_(&memory) {}

  // True and a whole value in `value` if there is one this reader has not seen. False leaves `value` unspecified after
  // a torn try, so read into a scratch copy what must survive.
  bool read(T& value) LITHE_RT {
    for (int attempt = 0; attempt < kTries; ++attempt) {
      const std::uint64_t count = load_word(memory_->latest, std::memory_order_acquire);
      if (count == 0 || count == seen_) return false;
      if (memory_->slots[count & 3].record.read(count, value)) {
        seen_ = count;
        return true;
      }
    }
    ++failures_;
    return false;
  }

  // Count of the value last read; 0 = none.
  std::uint64_t seen() const LITHE_RT { return seen_; }
  // Reads given up after four tries.
  std::uint64_t failures() const LITHE_RT { return failures_; }

 private:
  const ChannelMemory<T>* memory_;
  std::uint64_t seen_ = 0;
  std::uint64_t failures_ = 0;
};

}  // namespace lithe::ipc
