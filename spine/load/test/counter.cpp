// SPDX-License-Identifier: Apache-2.0
// For loader_test: counts its own steps, so that what a swap carries can be seen.
#include <lithe/law.hpp>

struct Counter {
  struct Params {
    lithe::Param gain_nm{0.5, 0, 1};
  };
  struct State {
    std::uint64_t steps = 0;
  };
  struct Probes {
    double steps = 0;
  };
  static void step(const lithe::Tick&, const Params& p, State& s, lithe::Effort& u, Probes& probes) {
    probes.steps = static_cast<double>(++s.steps);
    u.torque_nm[0] = p.gain_nm;
  }
};
LITHE_LAW(Counter, "counter");
