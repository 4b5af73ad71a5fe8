// SPDX-License-Identifier: Apache-2.0
// Which devices may interrupt a core. Off the tick.
#pragma once

#include <string>
#include <vector>

#include "spine/core/result.hpp"

namespace lithe {

struct Interrupt {
  int number = 0;    // as in /proc/irq
  std::string name;  // who handles it, as the kernel writes it: "eth0"
};

// All device interrupts, in the order of /proc/interrupts. What every core has for itself (its timer, its counters) is
// no device. An error, which names the file, when it cannot be read.
Result<std::vector<Interrupt>> device_interrupts(const std::string& root = "");

// The device interrupts that the kernel may send to a core, as their masks say now, ascending. An error, which names
// the file, when the mask of one of them cannot be read: nobody knows then. `root` holds the files of the kernel,
// /proc.
Result<std::vector<Interrupt>> interrupts_of(int cpu, const std::string& root = "");

// "2 device interrupts may land there: 24 eth0, 25 eth1"; names eight at most.
std::string interrupt_words(const Result<std::vector<Interrupt>>& found);
inline constexpr std::size_t kInterruptsNamed = 8;

}  // namespace lithe
