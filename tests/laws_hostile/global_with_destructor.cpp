// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// A global that wants to be destroyed.
#include <lithe/law.hpp>

struct Logger {
  double value = 0;
  ~Logger() { value = std::sin(value); }
};
Logger logger;

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { u.torque_nm[0] = logger.value; }
};
LITHE_LAW(Hostile, "global_with_destructor");
