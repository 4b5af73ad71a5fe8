// SPDX-License-Identifier: Apache-2.0
// Where the benches run: the Spine's core, and whether the kernel keeps others off it. One line of JSON.
#include "bench/machine.hpp"
#include "bench/samples.hpp"
#include "spine/robot/cpu_plan.hpp"

int main() {
  using namespace lithe::bench;
  const lithe::MachineCores machine = lithe::machine_cores();
  const Cores cores = pick_cores();
  JsonLine()
      .number("machine_usable_cores", static_cast<double>(machine.usable().size()))
      .number("machine_spine_core", cores.spine)
      .number("machine_partner_core", cores.partner)
      .word("machine_spine_core_isolation", lithe::robot::isolation_words(machine.isolated, cores.spine))
      .word("machine_partner_core_isolation", lithe::robot::isolation_words(machine.isolated, cores.partner))
      .print();
  return 0;
}
