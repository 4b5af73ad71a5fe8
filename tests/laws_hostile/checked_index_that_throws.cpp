// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: illegal_instruction
// gate: calls
// std::array::at throws when the index is wrong.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = t.position_rad.at(static_cast<std::size_t>(t.joints) + 100);
  }
};
LITHE_LAW(Hostile, "checked_index_that_throws");
