// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: text
// Characters that change the direction of writing: the comment is not where it seems to be.
#include <lithe/law.hpp>
// clang-format off
struct Hostile {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort& u) {
    /* safe: ‮ } ⁦if (false)⁩ ⁦ begin */ u.torque_nm[0] = 0.1; /* end ‮ { ⁦*/
  }
};
// clang-format on
LITHE_LAW(Hostile, "reads_otherwise_than_it_looks");
