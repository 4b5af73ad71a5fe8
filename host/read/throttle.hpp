// SPDX-License-Identifier: Apache-2.0
// Whether the processor is slowed down, because it is hot or its supply is too weak. Off the tick.
#pragma once

#include <cstdint>
#include <string>

#include "host/read/files.hpp"

namespace lithe::host {

// One reading of the kernel's files. `sources` is 0 where none could be read: then nothing is known.
struct Throttle {
  int sources = 0;          // files that could be read
  bool active = false;      // slowed down at this moment
  std::uint64_t count = 0;  // how often since boot, where the kernel counts (x86)
  std::string why;          // "cpu2 thermal_throttle/core_throttle_count 7"; empty if it never happened
};

// Reads the counters of x86 (thermal_throttle), the word of a Raspberry Pi's firmware (get_throttled), and the cooling
// devices that limit a processor's frequency.
Throttle read_throttle(const HostFiles& files);

// Compares readings.
class ThrottleWatch {
 public:
  // Takes a reading. Returns a sentence when throttling begins or ends, else an empty text. Throttling before the first
  // reading is not reported. Where the kernel only counts, throttling ends with a reading whose count has not grown.
  std::string look(const Throttle& now);

  bool active() const { return active_; }
  const std::string& why() const { return why_; }
  std::uint64_t times() const { return times_; }  // since the first reading

 private:
  bool first_ = true, active_ = false;
  std::uint64_t count_ = 0, times_ = 0;
  std::string why_;
};

}  // namespace lithe::host
