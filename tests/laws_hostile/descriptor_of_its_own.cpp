// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unloadable
// gate: words
// Writes its own descriptor, with sizes of its own.
#include <lithe/law.hpp>
struct Hostile {
  static void step(const lithe::Tick*, const void*, void*, lithe::Effort* u, double*) noexcept {
    u[9].torque_nm[0] = 1;
  }
};
extern "C" __attribute__((visibility("default"))) const LitheLaw lithe_law = {.magic = lithe::kLawMagic, .abi = 77};
