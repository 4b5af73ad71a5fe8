// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: system_call
// gate: words
// Enters the kernel through inline assembly, with a call (getppid) that no thread of the Spine needs.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
#if defined(__x86_64__)
    long pid = 110;
    asm volatile("syscall" : "+a"(pid) : : "rcx", "r11", "memory");
    u.torque_nm[0] = double(pid & 1);
#else
    asm volatile("mov x8, #173\n\tsvc #0" : : : "x0", "x8", "memory");
#endif
  }
};
LITHE_LAW(Hostile, "asm_syscall");
