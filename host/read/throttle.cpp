// SPDX-License-Identifier: Apache-2.0
#include "host/read/throttle.hpp"

#include <string_view>

#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr const char* kCpus = "/sys/devices/system/cpu";
constexpr const char* kCooling = "/sys/class/thermal";
constexpr const char* kFirmware = "/sys/devices/platform/soc/soc:firmware/get_throttled";

// Bits of the firmware's word: now, not since boot (those are 16 bits higher).
struct Bit {
  unsigned mask;
  const char* what;
};
constexpr Bit kBits[] = {{1u << 0, "under-voltage"},
                         {1u << 1, "frequency capped"},
                         {1u << 2, "throttled"},
                         {1u << 3, "soft temperature limit"}};

void read_counters(const HostFiles& files, Throttle& found) {
  for (const std::string& cpu : files.list(kCpus)) {
    if (!cpu.starts_with("cpu")) continue;
    for (const char* name : {"core_throttle_count", "package_throttle_count"}) {
      const Reading reading = files.read(std::string(kCpus) + "/" + cpu + "/thermal_throttle/" + name);
      const auto count = whole_number<std::uint64_t>(reading.value);
      if (!reading.known() || !count) continue;
      ++found.sources;
      found.count += *count;
      if (*count > 0) found.why = cpu + " " + name + " " + reading.value;
    }
  }
}

void read_firmware(const HostFiles& files, Throttle& found) {
  const Reading reading = files.read(kFirmware);
  const std::string_view digits = reading.value;
  const auto word = whole_number<std::uint64_t>(digits.substr(digits.starts_with("0x") ? 2 : 0), 16);
  if (!reading.known() || !word) return;
  ++found.sources;
  for (const Bit& bit : kBits) {
    if ((*word & bit.mask) == 0) continue;
    found.active = true;
    found.why = std::string("firmware: ") + bit.what;
  }
}

bool cools_a_processor(const std::string& type) {
  return type == "Processor" || type.starts_with("cpufreq-") || type.starts_with("thermal-cpufreq-");
}

void read_cooling(const HostFiles& files, Throttle& found) {
  for (const std::string& device : files.list(kCooling)) {
    if (!device.starts_with("cooling_device")) continue;
    const std::string folder = std::string(kCooling) + "/" + device;
    const Reading type = files.read(folder + "/type"), state = files.read(folder + "/cur_state");
    const auto level = whole_number<std::uint64_t>(state.value);
    if (!type.known() || !cools_a_processor(type.value) || !state.known() || !level) continue;
    ++found.sources;
    if (*level == 0) continue;
    found.active = true;
    found.why = type.value + " cooling state " + state.value;
  }
}

}  // namespace

Throttle read_throttle(const HostFiles& files) {
  Throttle found;
  read_counters(files, found);
  read_cooling(files, found);
  read_firmware(files, found);
  return found;
}

std::string ThrottleWatch::look(const Throttle& now) {
  const bool counted = !first_ && now.count > count_;
  const bool was = active_;
  active_ = now.active || counted;
  if (active_) why_ = now.why;
  first_ = false;
  count_ = now.count;
  if (active_ && !was) {
    ++times_;
    return "the processor is slowed down (" + why_ + "): ticks take longer; cool it, or lower rate_hz";
  }
  return was && !active_ ? "the processor has its full speed again" : "";
}

}  // namespace lithe::host
