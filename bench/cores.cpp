// SPDX-License-Identifier: Apache-2.0
// The cores of the benches: the Spine's core, whether it is isolated, and which devices may interrupt it.
// One line of JSON.
#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "spine/core/host/interrupts.hpp"
#include "spine/robot/cores/cpu_plan.hpp"

int main() {
  using namespace lithe::bench;
  const lithe::MachineCores machine = lithe::machine_cores();
  const Cores cores = pick_cores();
  JsonLine()
      .number("machine_usable_cores", static_cast<double>(machine.usable().size()))
      .number("machine_spine_core", cores.spine)
      .number("machine_partner_core", cores.partner)
      .word("machine_spine_core_isolation", lithe::robot::isolation_words(machine.isolated, cores.spine))
      .word("machine_spine_core_interrupts", lithe::interrupt_words(lithe::interrupts_of(cores.spine)))
      .word("machine_partner_core_isolation", lithe::robot::isolation_words(machine.isolated, cores.partner))
      .print();
  return 0;
}
