// SPDX-License-Identifier: Apache-2.0
// Harness of a law under trial: each of its arguments is in guarded memory of exactly its size.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "lithe/law.hpp"
#include "spine/core/time.hpp"

namespace lithe::trial {

// Guarded memory: detects writes beyond its ends. `bytes` bytes that end at an inaccessible page. The rest of their
// first page holds a pattern, and an inaccessible page is before it. A shared pair maps the same bytes twice: writable
// for us, read-only for the law.
// Contract: allocates once, never frees (the process ends after the trial) · not in the tick
class Guarded {
 public:
  enum class Kind { plain, with_read_only_view };

  // Aborts the process when there is no memory: a trial without guard pages would be useless.
  Guarded(std::size_t bytes, Kind kind);

  std::byte* data() const { return data_; }                // ours
  const std::byte* law_view() const { return law_view_; }  // the law's mapping
  std::size_t size() const { return size_; }

  // False when something before the bytes has been overwritten.
  bool fence_intact() const;

 private:
  std::byte* data_ = nullptr;
  std::byte* law_view_ = nullptr;
  std::size_t size_ = 0;
  std::span<std::byte> fence_;
};

// One law with its own state. Two harnesses of the same law have different addresses.
// Contract: allocates when made, never after · one thread
class LawHarness {
 public:
  // `params`: the law's own values, or those of the request; param_count of them.
  LawHarness(const LitheLaw& law, std::span<const Param> params, const History& past, const RawClock& clock);

  // A fresh state: the defaults, then the law's init on the recorded past, or on none.
  void reset(bool with_past = true);

  // One step on `in`. Returns how long the law took [ns].
  double step(const Tick& in) LITHE_RT;

  // Repeats the last step from the State before it. With `trap`, the processor ends it with SIGFPE at its first invalid
  // operation, if it can.
  void repeat(bool trap);

  const Effort& effort() const { return *reinterpret_cast<const Effort*>(effort_.data()); }
  const std::array<double, kMaxProbes>& probes();

  std::span<std::byte> state() { return {state_.data(), law_.state_size}; }

  // Names the memory that the law overwrote illegally; "" = none. Writes beyond the ends cause a page fault.
  const char* damage() const;

 private:
  const LitheLaw& law_;
  const RawClock& clock_;
  Guarded tick_, params_, state_, effort_, probes_, past_;
  History history_;
  std::vector<std::byte> before_;  // the State before the last step
  std::array<double, kMaxProbes> probe_values_{};
};

}  // namespace lithe::trial
