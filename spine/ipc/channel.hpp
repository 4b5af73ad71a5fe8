// SPDX-License-Identifier: Apache-2.0
// Channel, the latest value: one writer, many readers, no waiting; the writer may die during a write.
#pragma once

#include <algorithm>
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

  // A restarted writer continues from `latest`: a slot that its predecessor left odd is overwritten later; a value that
  // was finished but not announced (a reader may already have it) is announced first. So no record is ever more than
  // one ahead of `latest`, however many writers die (resume() below counts on it).
  void write(const T& value) LITHE_RT { write(value, kAll); }
  // Only the words in `used`: a reader must not use the others, which are from an earlier value.
  void write(const T& value, const wire::WordRanges& used) LITHE_RT {
    std::uint64_t count = load_word(memory_->latest, std::memory_order_relaxed) + 1;
    // acquire: the predecessor's value comes before our announcement of it.
    if (load_word(memory_->slots[count & 3].record.sequence, std::memory_order_acquire) == 2 * count)
      store_word(memory_->latest, count++, std::memory_order_release);
    memory_->slots[count & 3].record.write(count, value, used);
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
  static constexpr std::uint32_t kIdle = 64;  // reads in a row without news before `latest` is asked

  explicit ChannelReader(const ChannelMemory<T>& memory) : memory_(&memory) {}

  // True and a whole value in `value` if there is one this reader has not seen. False leaves `value` unspecified after
  // a torn try, so read into a scratch copy what must survive.
  bool read(T& value) LITHE_RT {
    for (int attempt = 0; attempt < kTries; ++attempt) {
      const std::uint64_t count = newest();
      if (count == seen_) {
        if (++idle_ % kIdle == 0) resume();
        return false;
      }
      if (memory_->slots[count & 3].record.read(count, value)) {
        seen_ = count;
        idle_ = 0;
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
  // Count of the newest value. A reader that keeps up finds it in the record it will read next, so one cache line
  // crosses from core to core instead of two; `latest` tells only one that has fallen behind.
  std::uint64_t newest() const LITHE_RT {
    const std::uint64_t next = seen_ + 1;
    const std::uint64_t there = sequence_of(next);
    if (there < 2 * next || there == (2 * next | 1)) return seen_;
    if (there == 2 * next && sequence_of(next + 1) < 2 * (next + 1)) return next;
    // max: the announcement of a value this reader already has may arrive after the value.
    return std::max(seen_, load_word(memory_->latest, std::memory_order_acquire));
  }
  // A live writer's `latest` is what this reader has seen, or one less on its way. After a long silence anything else
  // means that the memory was cleared or damaged: continue from there, otherwise a new writer would never be read.
  void resume() LITHE_RT {
    const std::uint64_t latest = load_word(memory_->latest, std::memory_order_acquire);
    if (latest != seen_ && latest + 1 != seen_) seen_ = latest == 0 ? 0 : latest - 1;
  }
  // acquire, with the release store that ends Record::write().
  std::uint64_t sequence_of(std::uint64_t count) const LITHE_RT {
    return load_word(memory_->slots[count & 3].record.sequence, std::memory_order_acquire);
  }

  const ChannelMemory<T>* memory_;
  std::uint64_t seen_ = 0;
  std::uint64_t failures_ = 0;
  std::uint32_t idle_ = 0;
};

}  // namespace lithe::ipc
