// SPDX-License-Identifier: Apache-2.0
// For tests: a scope in which this thread may not allocate.
#pragma once

#include <cstdint>

namespace lithe {

// While an instance lives, every malloc, calloc, realloc, free and operator new of this thread is counted. If there was
// one, the end of the scope fails the test, at the line where the scope was opened.
// Works with every compiler: a test links lithe_no_alloc, which replaces the allocator. A sanitizer has already
// replaced it; then nothing is counted (kCounts).
// Contract: test programs only · may be nested.
class NoAllocScope {
 public:
  static const bool kCounts;

  explicit NoAllocScope(const char* file = __builtin_FILE(), int line = __builtin_LINE());
  ~NoAllocScope();
  NoAllocScope(const NoAllocScope&) = delete;
  NoAllocScope& operator=(const NoAllocScope&) = delete;

 private:
  const char* file_;
  int line_;
  std::uint64_t at_start_;
};

}  // namespace lithe
