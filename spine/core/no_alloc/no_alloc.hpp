// SPDX-License-Identifier: Apache-2.0
// A scope in which this thread may not allocate: how a test proves that the tick does not.
#pragma once

#include <cstdint>

namespace lithe {

// While an instance lives, every malloc, calloc, realloc, free and operator new of this thread is counted.
// Works on every compiler: a test links spine/core/no_alloc.cpp, which takes the allocator's place.
// Contract: test programs only · may be nested.
class NoAllocScope {
 public:
  NoAllocScope();
  ~NoAllocScope();
  NoAllocScope(const NoAllocScope&) = delete;
  NoAllocScope& operator=(const NoAllocScope&) = delete;

  // Allocator calls made by this thread since the scope opened.
  std::uint64_t calls() const;

 private:
  std::uint64_t at_start_;
};

}  // namespace lithe
