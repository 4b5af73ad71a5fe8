// SPDX-License-Identifier: Apache-2.0
// Mailbox: one sender, one receiver, no loss; every message (letter) is answered.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "spine/ipc/words.hpp"

namespace lithe::ipc {

// The sender's half, in the sender's segment. Letter n (from 1, its ticket) lies at (n - 1) % N.
template <Payload T, std::size_t N>
  requires(N >= 2 && (N & (N - 1)) == 0)
struct MailboxMemory {
  struct alignas(64) Slot {
    Record<T> record;
  };
  alignas(kLine) std::uint64_t head;  // letters ever sent
  alignas(kLine) std::array<Slot, N> slots;
};

// The receiver's half, in the receiver's segment.
template <std::size_t N>
struct AckMemory {
  alignas(kLine) std::uint64_t tail;                    // letters ever taken
  alignas(kLine) std::array<std::uint64_t, N> results;  // low half of the ticket << 32 | answer
};

// Contract: one per mailbox · wait-free
template <Payload T, std::size_t N>
class MailboxSender {
 public:
  MailboxSender(MailboxMemory<T, N>& memory, const AckMemory<N>& ack) : memory_(&memory), ack_(&ack) {}

  // The letter's ticket; empty while N letters are waiting.
  std::optional<std::uint64_t> send(const T& letter) LITHE_RT {
    const std::uint64_t sent = load_word(memory_->head, std::memory_order_relaxed);
    // acquire, with the release store in receive(): the letter we are about to overwrite has been copied.
    if (sent - load_word(ack_->tail, std::memory_order_acquire) >= N) return std::nullopt;
    memory_->slots[sent % N].record.write(sent + 1, letter, kAll);
    // release, with the acquire load in receive(): the letter is whole before it is announced.
    store_word(memory_->head, sent + 1, std::memory_order_release);
    return sent + 1;
  }

  // The ticket of the last letter anybody has sent through this mailbox; 0 = none.
  std::uint64_t last_ticket() const LITHE_RT { return load_word(memory_->head, std::memory_order_relaxed); }

  // The answer to `ticket`; 0 (pending) until it is there.
  std::uint32_t poll(std::uint64_t ticket) const LITHE_RT {
    const std::uint64_t result = load_word(ack_->results[(ticket - 1) % N], std::memory_order_acquire);
    return static_cast<std::uint32_t>(result >> 32) == static_cast<std::uint32_t>(ticket)
               ? static_cast<std::uint32_t>(result)
               : 0;
  }

 private:
  static constexpr wire::WordRanges kAll = all_words<T>();
  MailboxMemory<T, N>* memory_;
  const AckMemory<N>* ack_;
};

// The sender may be hostile or dead: its head may be anything, its letters may change while they are read.
// Contract: RT · one per mailbox · wait-free
template <Payload T, std::size_t N>
class MailboxReceiver {
 public:
  // Starts after the letters that were sent before: letters of an earlier run are dropped.
  MailboxReceiver(const MailboxMemory<T, N>& memory, AckMemory<N>& ack)
      : memory_(&memory), ack_(&ack), taken_(load_word(memory.head, std::memory_order_acquire)) {
    store_word(ack_->tail, taken_, std::memory_order_release);
  }

  // The next letter and its ticket, if there is one. A head that jumps by more than N, or an announced letter that is
  // incomplete, is a protocol error of the sender: counted and skipped.
  bool receive(T& letter, std::uint64_t& ticket) LITHE_RT {
    const std::uint64_t head = load_word(memory_->head, std::memory_order_acquire);
    if (head == taken_) return false;
    if (head - taken_ > N) {
      ++violations_;
      taken_ = head;
      store_word(ack_->tail, taken_, std::memory_order_release);
      return false;
    }
    ticket = ++taken_;
    const bool whole = memory_->slots[(ticket - 1) % N].record.read(ticket, letter);
    if (!whole) ++violations_;
    // release, with the acquire load in send(): our copy is made before the sender may reuse the slot.
    store_word(ack_->tail, taken_, std::memory_order_release);
    return whole;
  }

  void answer(std::uint64_t ticket, std::uint32_t result) LITHE_RT {
    store_word(ack_->results[(ticket - 1) % N], ticket << 32 | result, std::memory_order_release);
  }

  // Number of protocol errors so far.
  std::uint64_t violations() const LITHE_RT { return violations_; }

 private:
  const MailboxMemory<T, N>* memory_;
  AckMemory<N>* ack_;
  std::uint64_t taken_;
  std::uint64_t violations_ = 0;
};

}  // namespace lithe::ipc
