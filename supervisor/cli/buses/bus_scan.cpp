// SPDX-License-Identifier: Apache-2.0
// `lithe bus scan`: refuses a bus that a running robot uses.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iostream>
#include <string>
#include <vector>

#include "supervisor/cli/buses/spines.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/talk.hpp"

namespace lithe::cli {

int bus_scan(const Context& context, const bus::Words& words, const bus::ScanOptions& options) {
  const bus::Choice choice =
      value_of(bus::choose(words), "bad_config", "name a robot file or a bus: lithe bus scan --help");
  std::vector<std::string> spines;
  for (const Occupied& each : spines_on(choice, [](const std::string& doubt) { std::cerr << doubt << std::endl; })) {
    const bool real = robot::is_real(each.config.buses[each.theirs]);
    if (real) spines.push_back(each.words());
  }
  if (!spines.empty()) {
    throw Refusal{"robot_running", fmt::format("a Spine works on this hardware: {}", fmt::join(spines, ", ")),
                  "stop it first: lithe stop; or watch its bus: lithe bus monitor"};
  }
  const bus::Scan scan = bus::scan(choice, options);
  finish(context, bus::to_json(scan, choice), [&](const Json&) { fmt::print("{}", bus::to_text(scan, choice)); });
  return scan.matches ? 0 : 1;
}

}  // namespace lithe::cli
