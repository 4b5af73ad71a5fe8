// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: memory
// A counter shared between laws of the same name.
#include <lithe/law.hpp>

template <class T>
struct Shared {
  static inline T counted = 0;
};

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-6 * ++Shared<int>::counted;
  }
};
LITHE_LAW(Hostile, "inline_variable");
