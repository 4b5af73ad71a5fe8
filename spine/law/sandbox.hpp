// SPDX-License-Identifier: Apache-2.0
// The memory that a law may write while it runs in the tick. The law works on copies: changes to its inputs, params or
// state have no effect until the host has checked the result.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>

#include "lithe/law.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/mapping.hpp"
#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/arithmetic.hpp"
#include "spine/law/resident.hpp"

namespace lithe::law {

// Contract: RT · owned by the tick thread
struct Sandbox {
  Tick tick;
  std::array<Param, kMaxParams> params{};
  alignas(64) std::array<std::byte, kMaxStateBytes> state{};
  alignas(64) Effort effort;
  std::array<double, kMaxProbes> probes{};
  void (*step)(const lithe::Tick*, const void*, void*, lithe::Effort*, double*) LITHE_RT = nullptr;

  // Copies the inputs of `law` for this tick.
  void enter(const Resident& law, const Tick& in) LITHE_RT;
  // The law itself, on the copies, as with_law_arithmetic() does it: a fault would leave its lambda by a jump, too.
  LITHE_LEFT_BY_A_JUMP void call() LITHE_RT {
    const std::uint64_t before = flush_denormals();
    step(&tick, params.data(), state.data(), &effort, probes.data());
    set_arithmetic_control(before);
  }
  // Copies its state back, after it has returned and its output is accepted.
  void keep_state(Resident& law) const LITHE_RT {
    std::memcpy(law.state.data(), state.data(), std::min<std::size_t>(law.descriptor->state_size, kMaxStateBytes));
  }
};

// A Sandbox on its own prefaulted pages, with a guard page on both sides.
// Contract: off the tick
class SandboxMemory {
 public:
  static Result<SandboxMemory> make();

  Sandbox& operator*() const { return *sandbox_; }

 private:
  SandboxMemory(Mapping pages, Sandbox* sandbox) : pages_(std::move(pages)), sandbox_(sandbox) {}
  Mapping pages_;
  Sandbox* sandbox_;
};

}  // namespace lithe::law
