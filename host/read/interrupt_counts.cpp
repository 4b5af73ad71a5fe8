// SPDX-License-Identifier: Apache-2.0
#include "host/read/interrupt_counts.hpp"

#include <algorithm>
#include <sstream>

#include "host/read/words.hpp"
#include "spine/core/host/interrupts.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr std::size_t kMostTableBytes = std::size_t{8} << 20;
constexpr const char* kTable = "/proc/interrupts";

bool is_timer(const std::string& label, const std::vector<std::string>& words) {
  return label == "LOC" || words.back() == "arch_timer" || words.back() == "riscv-timer";
}

bool is_of_cores(const std::string& label) {
  return label == "RES" || label == "CAL" || label == "TLB" || label.starts_with("IPI");
}

void add(std::optional<std::uint64_t>& sum, std::uint64_t count) { sum = sum.value_or(0) + count; }

}  // namespace

std::uint64_t CoreInterrupts::device_total() const {
  std::uint64_t total = 0;
  for (const DeviceCount& each : devices) total += each.count;
  return total;
}

Result<CoreInterrupts> count_interrupts(const HostFiles& files, int cpu) {
  const Result<std::vector<Interrupt>> devices = device_interrupts(files.root());
  const Reading table = files.read(kTable, kMostTableBytes);
  if (!devices || !table.known()) return Error{std::string(kTable) + " cannot be read"};
  std::istringstream lines(table.value);
  std::string line;
  std::getline(lines, line);
  const std::vector<std::string> head = split(line);
  const auto column = std::find(head.begin(), head.end(), "CPU" + std::to_string(cpu));
  if (column == head.end()) return Error{std::string(kTable) + " has no column of core " + std::to_string(cpu)};
  const auto at = static_cast<std::size_t>(column - head.begin()) + 1;  // behind the label
  CoreInterrupts counts;
  while (std::getline(lines, line)) {
    const std::vector<std::string> words = split(line);
    if (words.size() <= at || !words[0].ends_with(':')) continue;
    const std::optional<long long> count = whole_number(words[at]);
    if (!count) continue;
    const std::string label = words[0].substr(0, words[0].size() - 1);
    const auto device = std::find_if(devices->begin(), devices->end(),
                                     [&](const Interrupt& each) { return label == std::to_string(each.number); });
    const auto value = static_cast<std::uint64_t>(*count);
    if (device != devices->end())
      counts.devices.push_back({device->number, device->name, value});
    else if (is_timer(label, words))
      add(counts.timer, value);
    else if (is_of_cores(label))
      add(counts.cores, value);
  }
  return counts;
}

}  // namespace lithe::host
