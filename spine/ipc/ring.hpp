// SPDX-License-Identifier: Apache-2.0
// Ring, a broadcast of the last N records: the writer does not depend on readers; a reader counts the records it has
// lost.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/ipc/words.hpp"

namespace lithe::ipc {

// As it lies in shared memory. Record n (from 1) lies at (n - 1) % N.
template <Payload T, std::size_t N>
  requires(N >= 2 && (N & (N - 1)) == 0)
struct RingMemory {
  struct alignas(64) Slot {
    Record<T> record;
  };
  alignas(kLine) std::uint64_t head;  // records ever written
  alignas(kLine) std::array<Slot, N> slots;
};

// Contract: RT · exactly one per ring · push wait-free
template <Payload T, std::size_t N>
class RingWriter {
 public:
  explicit RingWriter(RingMemory<T, N>& memory) : memory_(&memory) {}

  // Writes only the words in `used`; the rest of the slot keeps what it held (zeros, where nobody ever writes it).
  void push(const T& record, const wire::WordRanges& used) LITHE_RT {
    const std::uint64_t count = load_word(memory_->head, std::memory_order_relaxed) + 1;
    memory_->slots[(count - 1) % N].record.write(count, record, used);
    // release, with the acquire load of head in the readers: the record is whole before it is announced.
    store_word(memory_->head, count, std::memory_order_release);
  }
  void push(const T& record) LITHE_RT { push(record, kAll); }

 private:
  static constexpr wire::WordRanges kAll = all_words<T>();
  RingMemory<T, N>* memory_;
};

// Contract: RT · any number, each with a cursor of its own · every call bounded
template <Payload T, std::size_t N>
class RingReader {
 public:
  // Starts at the end: sees what is written from now on.
  explicit RingReader(const RingMemory<T, N>& memory)
      : memory_(&memory), next_(load_word(memory.head, std::memory_order_acquire)) {}

  // Goes back to the oldest record that may still be there, or to the `count`-th newest.
  void rewind(std::uint64_t count = N) LITHE_RT {
    const std::uint64_t head = load_word(memory_->head, std::memory_order_acquire);
    const std::uint64_t back = count < N ? count : N;
    next_ = head > back ? head - back : 0;
  }

  // The next record in order; false when there is none, or when it was overwritten while being copied (then it counts
  // as lost, and the following call goes on).
  bool next(T& record) LITHE_RT {
    const std::uint64_t head = load_word(memory_->head, std::memory_order_acquire);
    if (next_ > head) next_ = head;  // the ring was made again
    if (head == next_) return false;
    if (head - next_ > N) {
      lost_ += head - N - next_;
      next_ = head - N;
    }
    const std::uint64_t count = ++next_;
    if (memory_->slots[(count - 1) % N].record.read(count, record)) return true;
    ++lost_;
    return false;
  }

  // The newest record, whatever the cursor; false when there is none yet or after four torn tries.
  bool latest(T& record) const LITHE_RT {
    for (int attempt = 0; attempt < 4; ++attempt) {
      const std::uint64_t head = load_word(memory_->head, std::memory_order_acquire);
      if (head == 0) return false;
      if (memory_->slots[(head - 1) % N].record.read(head, record)) return true;
    }
    return false;
  }

  bool empty() const LITHE_RT { return load_word(memory_->head, std::memory_order_acquire) == next_; }
  std::uint64_t lost() const LITHE_RT { return lost_; }

 private:
  const RingMemory<T, N>* memory_;
  std::uint64_t next_;  // records already seen or lost
  std::uint64_t lost_ = 0;
};

}  // namespace lithe::ipc
