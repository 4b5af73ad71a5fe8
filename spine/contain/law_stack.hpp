// SPDX-License-Identifier: Apache-2.0
// A separate stack for laws: a write past a local variable must not hit the tick's frames. Private to this room.
#pragma once

#include <cstddef>

#include "spine/contain/fault_barrier.hpp"
#include "spine/core/mapping.hpp"
#include "spine/core/result.hpp"

// Called from the assembly in law_stack.cpp, on the law's stack.
extern "C" {
[[gnu::visibility("hidden")]] void lithe_contain_shut() noexcept;
[[gnu::visibility("hidden")]] void* lithe_contain_way_back() noexcept;
}

namespace lithe::contain {

// Twice the stack that admission allows for a law with its library calls (lawd/object/admission_stack.cpp).
inline constexpr std::size_t kLawStackBytes = std::size_t{256} << 10;
// Guard area below and above; larger than the largest allowed frame, so that no frame skips it.
inline constexpr std::size_t kLawGuardBytes = std::size_t{64} << 10;

// Contract: made and freed off the tick · touched and locked · forget_frames() before it is freed
class LawStack {
 public:
  static Result<LawStack> make();

  // Runs call(context) on it, with the protected memory closed. Returns through the data in `Core`: the law may have
  // overwritten its whole stack and the callee-saved registers.
  void run(FaultBarrier::Call call, void* context) LITHE_RT;

  // To be called after an ended call, and after the last one: tells AddressSanitizer that the abandoned frames are
  // free.
  void forget_frames() const LITHE_RT;

 private:
  friend void* ::lithe_contain_way_back() noexcept;
  Mapping memory_;
  void* way_back_ = nullptr;  // the thread's own stack pointer, while a law runs
};

}  // namespace lithe::contain
