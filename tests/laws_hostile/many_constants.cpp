// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: size
// A table of 800 KB.
#include <lithe/law.hpp>

constexpr std::array<double, 100000> make() {
  std::array<double, 100000> a{};
  for (std::size_t i = 0; i < a.size(); i += 7) a[i] = double(i);
  return a;
}
constexpr std::array<double, 100000> kTable = make();

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = kTable[t.tick % kTable.size()] * 1e-9;
  }
};
LITHE_LAW(Hostile, "many_constants");
