// SPDX-License-Identifier: Apache-2.0
// Faulty laws for tests and the bench. Each one is a callback for FaultBarrier::run().
#pragma once

#include <signal.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cstdint>
#include <cstdlib>

#include "spine/wire/wire.hpp"

// A sanitizer would report these before the processor does.
// A function keeps its own address also where all its callers are compiled with it: a test compares that with a
// fault's.
#if defined(__clang__)
#define LITHE_BAD [[gnu::noinline, gnu::no_sanitize("address"), gnu::no_sanitize("undefined")]] inline
#else
#define LITHE_BAD [[gnu::noipa, gnu::no_sanitize("address"), gnu::no_sanitize("undefined")]] inline
#endif

namespace lithe::contain::bad {

using wire::LawFaultKind;

LITHE_BAD void nothing(void*) {}

LITHE_BAD void count(void* counter) { *static_cast<volatile int*>(counter) = *static_cast<volatile int*>(counter) + 1; }

LITHE_BAD void store_at(std::uintptr_t address) {
  asm volatile("" : "+r"(address));  // the compiler must not see what is wrong with it
  *reinterpret_cast<volatile int*>(address) = 1;
}

LITHE_BAD void write_null(void*) { store_at(0x10); }

LITHE_BAD void write_nowhere(void*) { store_at(std::uintptr_t{1} << 60); }  // not a canonical address: never mapped

LITHE_BAD void write_text(void*) { store_at(reinterpret_cast<std::uintptr_t>(&write_null)); }

LITHE_BAD void jump_to_null(void*) {
  void (*volatile nowhere)() = nullptr;
  nowhere();
}

// Past the end of the file behind a mapping.
LITHE_BAD void leave_file(void* page) { *static_cast<volatile int*>(page) = 1; }
inline void* page_without_file() {
  const int file = memfd_create("lithe-test", MFD_CLOEXEC);
  void* page = mmap(nullptr, 4096, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  close(file);
  return page;
}

LITHE_BAD void divide_by_zero(void*) {
#if defined(__x86_64__)
  asm volatile("xorl %%ecx, %%ecx\n\tmovl $1, %%eax\n\tcltd\n\tidivl %%ecx" : : : "eax", "ecx", "edx");
#else
  raise(SIGFPE);  // AArch64 does not trap on division by zero
#endif
}

LITHE_BAD void execute_garbage(void*) {
#if defined(__x86_64__)
  asm volatile("ud2");
#else
  asm volatile(".inst 0");
#endif
}

LITHE_BAD void hit_breakpoint(void*) {
#if defined(__x86_64__)
  asm volatile("int3");
#else
  asm volatile("brk #0");
#endif
}

LITHE_BAD void give_up(void*) { std::abort(); }

LITHE_BAD int recurse(int depth) {
  volatile char frame[2048];                   // smaller than the guard area, so that no frame skips it
  asm volatile("" : : "r"(frame) : "memory");  // all of it
  frame[0] = static_cast<char>(depth);
  const int below = depth == 0 ? 0 : recurse(depth + 1);
  return below + frame[0];  // read after the call: no tail call
}
LITHE_BAD void overflow_stack(void*) { recurse(1); }

LITHE_BAD void loop_forever(void*) {
  for (;;) asm volatile("");
}

// Written by hand: RealtimeSanitizer intercepts the library functions.
LITHE_BAD long call_kernel(long number, long a = 0, long b = 0, long c = 0, long d = 0) {
#if defined(__x86_64__)
  register long fourth asm("r10") = d;
  asm volatile("syscall" : "+a"(number) : "D"(a), "S"(b), "d"(c), "r"(fourth) : "rcx", "r11", "memory");
  return number;
#else
  register long which asm("x8") = number;
  register long x0 asm("x0") = a;
  register long x1 asm("x1") = b;
  register long x2 asm("x2") = c;
  register long x3 asm("x3") = d;
  asm volatile("svc #0" : "+r"(x0) : "r"(which), "r"(x1), "r"(x2), "r"(x3) : "memory");
  return x0;
#endif
}

LITHE_BAD void ask_for_parent(void*) { call_kernel(SYS_getppid); }

struct Case {
  const char* name;
  void (*call)(void*);
  LawFaultKind kind;
};
inline constexpr std::array<Case, 9> kCrashes{{{"write_null", write_null, LawFaultKind::bad_access},
                                               {"write_nowhere", write_nowhere, LawFaultKind::bad_access},
                                               {"write_text", write_text, LawFaultKind::bad_access},
                                               {"jump_to_null", jump_to_null, LawFaultKind::bad_access},
                                               {"divide_by_zero", divide_by_zero, LawFaultKind::arithmetic},
                                               {"execute_garbage", execute_garbage, LawFaultKind::illegal_instruction},
                                               {"hit_breakpoint", hit_breakpoint, LawFaultKind::trapped},
                                               {"give_up", give_up, LawFaultKind::aborted},
                                               {"overflow_stack", overflow_stack, LawFaultKind::bad_access}}};

}  // namespace lithe::contain::bad
