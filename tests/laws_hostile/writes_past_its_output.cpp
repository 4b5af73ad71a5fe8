// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Writes torques for joints that cannot exist, and on into its probes. Further on is a page that no law may touch.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::size_t j = 0; j < 165; ++j) ((volatile double*)&u)[j] = 0.01;
  }
};
LITHE_LAW(Hostile, "writes_past_its_output");
