// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: includes
// Starts a thread.
#include <lithe/law.hpp>
#include <thread>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    std::thread([] {}).detach();
  }
};
LITHE_LAW(Hostile, "includes_thread");
