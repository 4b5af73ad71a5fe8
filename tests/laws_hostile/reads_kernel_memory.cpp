// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: bad_access
// Reads an address of the kernel.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-3 * double(*(volatile long*)0xffff'8000'0000'0000 & 1);
  }
};
LITHE_LAW(Hostile, "reads_kernel_memory");
