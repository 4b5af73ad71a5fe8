// SPDX-License-Identifier: Apache-2.0
// The stack a law runs on: not the tick's, whose frames and return addresses a slip past a local would hit. Private to
// this room.
#pragma once

#include <cstddef>

#include "spine/contain/cell.hpp"
#include "spine/core/result.hpp"

// Called from the assembly in law_stack.cpp, on the law's stack.
extern "C" {
[[gnu::visibility("hidden")]] void lithe_contain_shut() noexcept;
[[gnu::visibility("hidden")]] void* lithe_contain_way_back() noexcept;
}

namespace lithe::contain {

// Twice what admission lets a law and the library under it have (lawd/object/admission_stack.cpp).
inline constexpr std::size_t kLawStackBytes = std::size_t{256} << 10;
// Below and above it; more than a frame may have, so that none reaches over it.
inline constexpr std::size_t kLawGuardBytes = std::size_t{64} << 10;

// Contract: made and freed off the tick · touched and locked
class LawStack {
 public:
  static Result<LawStack> make();
  LawStack() = default;
  LawStack(LawStack&& other) noexcept;
  LawStack& operator=(LawStack&& other) noexcept;
  ~LawStack();

  // Runs call(context) on it, with the vault shut. Comes back by what `Core` holds: the law may have overwritten every
  // word of its stack, and every register that it promised to keep.
  void run(Cell::Call call, void* context) LITHE_RT;

  // After a call that was cut off: AddressSanitizer still believes in the frames it left.
  void forget_frames() const LITHE_RT;

 private:
  friend void* ::lithe_contain_way_back() noexcept;
  std::byte* base_ = nullptr;
  void* way_back_ = nullptr;  // the thread's own stack pointer, while a law runs
};

}  // namespace lithe::contain
