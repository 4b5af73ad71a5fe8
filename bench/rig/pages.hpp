// SPDX-License-Identifier: Apache-2.0
// What a page costs that is not there, or whose mark "was accessed" the machine has cleared (docs/rt.md).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/ipc/words.hpp"
#include "spine/loop/clock.hpp"

namespace lithe::bench {

// Writes one word of each page back as it was; how long that took [ns].
// Contract: nobody else writes this memory
inline std::int64_t touch_ns(loop::SteeredClock& clock, std::span<std::uint64_t> words) {
  constexpr std::size_t kPageWords = 4096 / sizeof(std::uint64_t);
  const auto touch = [](std::uint64_t& word) {
    ipc::store_word(word, ipc::load_word(word, std::memory_order_relaxed), std::memory_order_relaxed);
  };
  const std::int64_t from_ns = clock.now_ns();
  for (std::size_t at = 0; at < words.size(); at += kPageWords) touch(words[at]);
  touch(words.back());  // the memory may begin in the middle of a page
  return clock.now_ns() - from_ns;
}

}  // namespace lithe::bench
