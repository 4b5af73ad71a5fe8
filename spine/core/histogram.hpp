// SPDX-License-Identifier: Apache-2.0
// A fixed-bin histogram of durations that the tick can feed and anyone can read.
#pragma once

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/core/rt.hpp"

namespace lithe {

// Log-linear bins: exact below 32 ns, then 32 bins per octave (a bin is at most 3.2 % wide), up to 25 s;
// longer durations land in the last bin, and `max_ns` keeps them exact.
inline constexpr std::size_t kHistogramBins = 976;

constexpr std::size_t histogram_bin(std::uint64_t duration_ns) LITHE_RT {
  if (duration_ns < 32) return static_cast<std::size_t>(duration_ns);
  const auto octave = static_cast<std::size_t>(std::bit_width(duration_ns)) - 6;  // 0 for [32, 64)
  const auto within = static_cast<std::size_t>(duration_ns >> octave) - 32;       // top five bits after the leading one
  return std::min(32 + octave * 32 + within, kHistogramBins - 1);
}

// Smallest duration that falls into `bin` [ns].
constexpr std::uint64_t histogram_bin_floor_ns(std::size_t bin) {
  if (bin < 32) return bin;
  const std::size_t octave = (bin - 32) / 32;
  const std::size_t within = (bin - 32) % 32;
  return (std::uint64_t{32} + within) << octave;
}

// A view on counters that live elsewhere (shared memory, a test's array). `T` is wire::Histogram or anything with
// `bin[kHistogramBins]`, `count`, `max_ns` and `sum_ns` of std::uint64_t.
// Contract: add() RT · one writer · readers may look at any time and see each counter whole.
template <class T>
class HistogramWriter {
 public:
  explicit HistogramWriter(T& counters) : counters_(&counters) {}

  void add(std::int64_t duration_ns) LITHE_RT {
    const auto value = static_cast<std::uint64_t>(std::max<std::int64_t>(duration_ns, 0));
    bump(counters_->bin[histogram_bin(value)], 1);
    bump(counters_->count, 1);
    bump(counters_->sum_ns, value);
    if (value > counters_->max_ns) relaxed(counters_->max_ns).store(value, std::memory_order_relaxed);
  }

 private:
  static std::atomic_ref<std::uint64_t> relaxed(std::uint64_t& word) LITHE_RT {
    return std::atomic_ref<std::uint64_t>(word);
  }
  // A single writer needs no read-modify-write: a relaxed load and store keep every reader's view whole.
  static void bump(std::uint64_t& word, std::uint64_t by) LITHE_RT {
    relaxed(word).store(relaxed(word).load(std::memory_order_relaxed) + by, std::memory_order_relaxed);
  }
  T* counters_;
};

// Duration below which the fraction `q` (0..1) of the counts lies [ns], to the upper edge of its bin.
// Contract: not in the tick (walks every bin).
inline std::uint64_t histogram_quantile_ns(std::span<const std::uint64_t> bins, double q) {
  std::uint64_t total = 0;
  for (const std::uint64_t count : bins) total += count;
  if (total == 0) return 0;
  const auto wanted = static_cast<std::uint64_t>(q * static_cast<double>(total - 1)) + 1;
  std::uint64_t seen = 0;
  for (std::size_t bin = 0; bin < bins.size(); ++bin) {
    seen += bins[bin];
    if (seen >= wanted) return bin < 32 ? bin : histogram_bin_floor_ns(bin + 1) - 1;
  }
  return histogram_bin_floor_ns(bins.size() - 1);
}

}  // namespace lithe
