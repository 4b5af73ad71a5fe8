// SPDX-License-Identifier: Apache-2.0
// Copies payloads through shared memory as 64-bit relaxed atomic words, and guards one record with a sequence.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "spine/core/rt.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::ipc {

// Items lie on pairs of cache lines of their own (adjacent-line prefetch couples two; some ARM lines are 128 bytes).
inline constexpr std::size_t kLine = 128;

template <class T>
concept Payload = std::is_trivially_copyable_v<T> && sizeof(T) % 8 == 0 && alignof(T) <= 8;

// Loads and stores of shared words. Relaxed: the fences around a record give the order.
inline std::uint64_t load_word(const std::uint64_t& word, std::memory_order order) LITHE_RT {
  // atomic_ref wants a mutable lvalue before C++26; loading changes nothing, and read-only mappings are only loaded.
  return std::atomic_ref<std::uint64_t>(const_cast<std::uint64_t&>(word)).load(order);
}
inline void store_word(std::uint64_t& word, std::uint64_t value, std::memory_order order) LITHE_RT {
  std::atomic_ref<std::uint64_t>(word).store(value, order);
}

// One record: a sequence word, 2c while it holds value c (c counts from 1), odd while it is being written; and the
// value. Each order names its partner; models/record.inc has them all, and what breaks without each.
template <Payload T>
struct Record {
  std::uint64_t sequence;
  std::uint64_t words[sizeof(T) / 8];

  // Contract: RT · the item's single writer · wait-free
  void write(std::uint64_t count, const T& value, const wire::WordRanges& used) LITHE_RT {
    store_word(sequence, 2 * count | 1, std::memory_order_relaxed);
    // release fence, with the reader's acquire fence: whoever sees a word of this value also sees the odd sequence.
    std::atomic_thread_fence(std::memory_order_release);
    const auto* bytes = reinterpret_cast<const unsigned char*>(&value);
    for (std::uint32_t r = 0; r < used.size; ++r) {
      const auto [first, number] = used.range[r];
      for (std::uint32_t i = first; i < first + number; ++i) {
        std::uint64_t word;
        std::memcpy(&word, bytes + 8 * std::size_t{i}, 8);
        store_word(words[i], word, std::memory_order_relaxed);
      }
    }
    // release, with the acquire load in read(): the value is whole before its even sequence is seen.
    store_word(sequence, 2 * count, std::memory_order_release);
  }

  // Copies value `count` out; false if another one is there, or arrives meanwhile.
  // Contract: RT · any number of readers · wait-free
  bool read(std::uint64_t count, T& value) const LITHE_RT {
    if (load_word(sequence, std::memory_order_acquire) != 2 * count) return false;
    auto* bytes = reinterpret_cast<unsigned char*>(&value);
    for (std::size_t i = 0; i < sizeof(T) / 8; ++i) {
      const std::uint64_t word = load_word(words[i], std::memory_order_relaxed);
      std::memcpy(bytes + 8 * i, &word, 8);
    }
    // acquire fence, with the writer's release fence: had a word come from a later value, its odd sequence shows here.
    std::atomic_thread_fence(std::memory_order_acquire);
    return load_word(sequence, std::memory_order_relaxed) == 2 * count;
  }
};

// All words of T.
template <Payload T>
constexpr wire::WordRanges all_words() {
  wire::WordRanges all;
  all.add(0, sizeof(T));
  return all;
}

}  // namespace lithe::ipc
