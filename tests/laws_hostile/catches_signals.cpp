// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: uncompilable
// gate: includes
// Takes over the signals that contain it.
#include <csignal>
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    std::signal(11, [](int) {});
  }
};
LITHE_LAW(Hostile, "catches_signals");
