// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// A million steps written out.
#include <lithe/law.hpp>
#define C0 x = x * 1.5 + 0.5;
#define C1 C0 C0 C0 C0 C0 C0 C0 C0 C0 C0
#define C2 C1 C1 C1 C1 C1 C1 C1 C1 C1 C1
#define C3 C2 C2 C2 C2 C2 C2 C2 C2 C2 C2
#define C4 C3 C3 C3 C3 C3 C3 C3 C3 C3 C3
#define C5 C4 C4 C4 C4 C4 C4 C4 C4 C4 C4
#define C6 C5 C5 C5 C5 C5 C5 C5 C5 C5 C5

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double x = 0;
    C6 u.torque_nm[0] = x;
  }
};
LITHE_LAW(Hostile, "much_code");
