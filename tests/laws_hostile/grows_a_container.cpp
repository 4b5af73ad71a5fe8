// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: uncompilable
// gate: includes
// A std::vector that grows.
#include <lithe/law.hpp>
#include <vector>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    std::vector<double> past;
    for (std::uint32_t j = 0; j < t.joints; ++j) past.push_back(t.position_rad[j]);
    u.torque_nm[0] = past.back();
  }
};
LITHE_LAW(Hostile, "grows_a_container");
