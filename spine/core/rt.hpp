// SPDX-License-Identifier: Apache-2.0
// The real-time contract as an annotation that the compiler checks.
#pragma once

// LITHE_RT ends the signature of every function that runs inside the tick, and of no other. It promises: no allocation,
// no lock, no throw, no log, no system call, no unbounded loop. clang >= 20 checks this (-Wfunction-effects) and
// RealtimeSanitizer enforces it at run time; g++ keeps the noexcept.
#if defined(__clang__) && __clang_major__ >= 20
#define LITHE_RT noexcept [[clang::nonblocking]]
// A law fault leaves these functions by a jump. RealtimeSanitizer counts nested LITHE_RT calls, so it must not count
// these.
#define LITHE_LEFT_BY_A_JUMP [[clang::no_sanitize("realtime")]]
#else
#define LITHE_RT noexcept
#define LITHE_LEFT_BY_A_JUMP
#endif

// Opens a scope in which the effect analysis is off. The reason is part of the source: `make check` lists them.
// Use it as   LITHE_RT_EXEMPT("why this call is bounded", { call(); });
#if defined(__clang__) && __clang_major__ >= 20
#define LITHE_RT_EXEMPT(reason, ...)                                                          \
  _Pragma("clang diagnostic push") _Pragma("clang diagnostic ignored \"-Wfunction-effects\"") \
      __VA_ARGS__ _Pragma("clang diagnostic pop")
#else
#define LITHE_RT_EXEMPT(reason, ...) __VA_ARGS__
#endif
