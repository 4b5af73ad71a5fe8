// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unloadable
// gate: preprocessor
// Compiled for another number of joints: another layout of everything.
#define LITHE_NJ 64
#include <lithe/law.hpp>
struct Hostile {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u) { u.torque_nm[40] = t.t_s; }
};
LITHE_LAW(Hostile, "other_joint_capacity");
