// SPDX-License-Identifier: Apache-2.0
// `lithe bus scan`: runs the scan, and prints the findings as text or JSON.
#pragma once

#include <string>
#include <vector>

#include "supervisor/bus/plan/report.hpp"
#include "supervisor/bus/scan/judge.hpp"
#include "supervisor/bus/scan/place.hpp"

namespace lithe::bus {

struct ScanOptions {
  double listen_s = 1.1;  // longer than the pause between two heartbeats of most devices
};

struct Scan {
  std::vector<BusFindings> buses;
  bool matches = false;  // as the file says; without a file: a device answers and there is no error
};

// Opens the chosen buses, listens to all together, then asks on one after the other. A bus that cannot be opened, and a
// loop bus, are findings, not errors.
// Contract: not RT · takes seconds · nothing it sends can move a motor
Scan scan(const Choice& choice, const ScanOptions& options);

Json to_json(const Scan& scan, const Choice& choice);
std::string to_text(const Scan& scan, const Choice& choice);

}  // namespace lithe::bus
