// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: bad_access
// gate: stack
// Two functions that call each other without end.
#include <lithe/law.hpp>

double odd(const lithe::Tick& t, unsigned n);
[[gnu::noinline]] double even(const lithe::Tick& t, unsigned n) {
  volatile double here = t.position_rad[n % 8];
  return n == 0 ? here : odd(t, n - 1) + here;
}
[[gnu::noinline]] double odd(const lithe::Tick& t, unsigned n) {
  volatile double here = t.velocity_rad_s[n % 8];
  return n == 0 ? here : even(t, n - 1) - here;
}

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-9 * even(t, 4'000'000'000u);
  }
};
LITHE_LAW(Hostile, "mutual_recursion");
