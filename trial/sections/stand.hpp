// SPDX-License-Identifier: Apache-2.0
// Where a law stands trial: each thing it is given lies in fenced memory of exactly its size.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "lithe/law.hpp"
#include "spine/core/time.hpp"
#include "trial/sections/guarded.hpp"

namespace lithe::trial {

// One law with its own state. Two stands of the same law lie at different addresses.
// Contract: allocates when made, never after · one thread
class Stand {
 public:
  // `params`: the law's own values, or those the request wants; param_count of them.
  Stand(const LitheLaw& law, std::span<const Param> params, const History& past, const RawClock& clock);

  // A fresh state: the defaults, then the law's init on the recorded past, or on none.
  void reset(bool with_past = true);

  // One step on `in`. Returns how long the law took [ns].
  double step(const Tick& in);

  const Effort& effort() const { return *reinterpret_cast<const Effort*>(effort_.data()); }
  const std::array<double, kMaxProbes>& probes();

  std::span<std::byte> state() { return {state_.data(), law_.state_size}; }

  // What the law wrote where it must not, "" = nothing. Beyond the ends the processor notices by itself.
  const char* damage() const;

 private:
  const LitheLaw& law_;
  const RawClock& clock_;
  Guarded tick_, params_, state_, effort_, probes_, past_;
  History history_;
  std::array<double, kMaxProbes> probe_values_{};
};

}  // namespace lithe::trial
