// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// Templates that never end.
#include <lithe/law.hpp>

template <int N>
struct Deep {
  static constexpr int value = Deep<N + 1>::value + 1;
};

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = Deep<0>::value;
  }
};
LITHE_LAW(Hostile, "template_bomb");
