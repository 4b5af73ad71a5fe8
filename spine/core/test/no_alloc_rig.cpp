// SPDX-License-Identifier: Apache-2.0
#include "spine/core/test/no_alloc_rig.hpp"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdlib>

// A sanitizer has its own allocator; replacing that one too crashes the program before main.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define LITHE_FOREIGN_ALLOCATOR 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || __has_feature(realtime_sanitizer)
#define LITHE_FOREIGN_ALLOCATOR 1
#endif
#endif

namespace {

thread_local int g_depth = 0;
thread_local std::uint64_t g_calls = 0;

}  // namespace

#ifndef LITHE_FOREIGN_ALLOCATOR
namespace {

void count() {
  if (g_depth > 0) ++g_calls;
}

}  // namespace

// glibc exports its allocator under these names too, so the wrappers need no dlsym (which itself allocates).
extern "C" {
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* old, std::size_t size);
void __libc_free(void* old);

void* malloc(std::size_t size) noexcept {
  count();
  return __libc_malloc(size);
}
void* calloc(std::size_t number, std::size_t size) noexcept {
  count();
  return __libc_calloc(number, size);
}
void* realloc(void* old, std::size_t size) noexcept {
  count();
  return __libc_realloc(old, size);
}
void free(void* old) noexcept {
  if (old != nullptr) count();  // the C library's own qsort frees nothing at all
  __libc_free(old);
}
}
#endif

namespace lithe {

#ifdef LITHE_FOREIGN_ALLOCATOR
const bool NoAllocScope::kCounts = false;
#else
const bool NoAllocScope::kCounts = true;
#endif

NoAllocScope::NoAllocScope(const char* file, int line) : file_(file), line_(line), at_start_(g_calls) { ++g_depth; }

NoAllocScope::~NoAllocScope() {
  --g_depth;
  const std::uint64_t calls = g_calls - at_start_;
  if (calls > 0) ADD_FAILURE_AT(file_, line_) << calls << " calls of the allocator in a scope that allows none";
}

}  // namespace lithe
