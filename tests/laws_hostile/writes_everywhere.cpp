// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: bad_access
// Writes at addresses made from its input.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (int i = 0; i < 64; ++i) *(volatile long*)((t.tick * 2654435761u + static_cast<std::uint64_t>(i)) << 12) = 1;
  }
};
LITHE_LAW(Hostile, "writes_everywhere");
