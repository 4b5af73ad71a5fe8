// SPDX-License-Identifier: Apache-2.0
// Items 25 to 29: frequency, sleep states, power of buses.
#include <fmt/format.h>

#include "host/doctor/item.hpp"
#include "host/read/machine.hpp"
#include "host/read/words.hpp"

namespace lithe::host {
namespace {

constexpr const char* kCpus = "/sys/devices/system/cpu";
constexpr const char* kPolicies = "/sys/devices/system/cpu/cpufreq";
constexpr long long kShallowUs = 2;

std::string frequency_folder(const Subject& subject) { return fmt::format("{}/cpu{}/cpufreq", kCpus, subject.cpu); }

// The kernel sets no frequency: no driver, so no policy of any core (many virtual machines, fixed boards).
bool has_no_frequency(const Subject& subject) {
  return has_no(subject, fmt::format("{}/cpu{}", kCpus, subject.cpu), "cpufreq") &&
         subject.files.list(kPolicies).empty();
}

// Drivers that choose a frequency themselves, also under the governor `performance`.
bool chooses_itself(const std::string& driver) {
  return driver.starts_with("intel_pstate") || driver.starts_with("amd-pstate") || driver.starts_with("amd_pstate");
}

State judge_range(const std::string& folder, Notes& notes) {
  const Reading driver = notes.read(folder + "/scaling_driver");
  if (driver.value.empty()) return State::unknown;
  if (!chooses_itself(driver.value)) return State::ok;
  const auto least = notes.number(folder + "/scaling_min_freq"), most = notes.number(folder + "/scaling_max_freq");
  return !least || !most ? State::unknown : *least == *most ? State::ok : State::warn;
}

// A Raspberry Pi lowers its clock when its supply is too weak, whatever the governor says.
State judge_supply(const Subject& subject, Notes& notes) {
  const BoardKind board = board_of(subject.files);
  if (board == BoardKind::unknown) return State::unknown;
  if (board != BoardKind::raspberry_pi) return State::not_applicable;
  for (const std::string& each : subject.files.list("/sys/class/hwmon")) {
    const std::string folder = "/sys/class/hwmon/" + each;
    if (subject.files.read(folder + "/name").value != "rpi_volt") continue;
    const std::optional<long long> alarm = notes.number(folder + "/in0_lcrit_alarm");
    return !alarm ? State::unknown : *alarm == 0 ? State::ok : State::warn;
  }
  notes.add("/sys/class/hwmon/*/name", "no rpi_volt");
  return State::unknown;
}

Finding check_governor(const Subject& subject, Notes& notes) {
  const std::string folder = frequency_folder(subject);
  if (has_no_frequency(subject)) {
    notes.add(kPolicies, "(no policy)");
    return notes.say(State::not_applicable, "the kernel does not set the frequency here");
  }
  const Reading governor = notes.read(folder + "/scaling_governor");
  const State set = governor.value.empty() ? State::unknown : governor.value == "performance" ? State::ok : State::warn;
  const State range = judge_range(folder, notes), supply = judge_supply(subject, notes);
  const State state = worst({set, range, supply});
  if (set == State::warn) return notes.say(state, "governor " + governor.value);
  if (supply == State::warn) return notes.say(state, "the supply voltage is too low: the board lowers its clock");
  if (range == State::warn) return notes.say(state, "the driver may lower the frequency: minimum and maximum differ");
  if (state == State::unknown) return notes.say(state, "not all that sets the frequency can be read");
  return notes.say(state, "the frequency is fixed");
}

Finding check_turbo(const Subject& subject, Notes& notes) {
  const std::optional<long long> no_turbo = notes.number(fmt::format("{}/intel_pstate/no_turbo", kCpus));
  const std::optional<long long> boost = notes.number(fmt::format("{}/boost", kPolicies));
  if (no_turbo == 0 || boost == 1) return notes.say(State::warn, "turbo is on: the frequency depends on heat and load");
  if (no_turbo || boost) return notes.say(State::ok, "turbo is off");
  if (has_no_frequency(subject)) return notes.say(State::not_applicable, "the kernel does not set the frequency here");
  const BoardKind board = board_of(subject.files);
  if (board == BoardKind::raspberry_pi || board == BoardKind::jetson) {
    notes.read("/proc/device-tree/model");
    return notes.say(State::not_applicable, "this board has no turbo");
  }
  return notes.say(State::unknown, "no file tells whether turbo is on");
}

Finding check_idle_states(const Subject& subject, Notes& notes) {
  const Reading driver = notes.read(fmt::format("{}/cpuidle/current_driver", kCpus));
  if (driver.value == "none") return notes.say(State::not_applicable, "the kernel chooses no sleep state here");
  const std::string folder = fmt::format("{}/cpu{}/cpuidle", kCpus, subject.cpu);
  bool all_read = driver.known(), any = false;
  std::string deep;
  for (const std::string& each : subject.files.list(folder)) {
    if (!each.starts_with("state")) continue;
    any = true;
    const std::string state = folder + "/" + each;
    const auto latency_us = notes.number(state + "/latency"), disabled = notes.number(state + "/disable");
    all_read = all_read && latency_us && disabled;
    if (!latency_us || *latency_us <= kShallowUs || disabled != 0) continue;
    deep =
        fmt::format("{} is allowed and takes {} us to leave", subject.files.read(state + "/name").value, *latency_us);
  }
  if (!deep.empty()) return notes.say(State::warn, "sleep state " + deep);
  if (!any || !all_read) return notes.say(State::unknown, "not all sleep states of the core can be read");
  return notes.say(State::ok, "the core leaves every allowed sleep state within {} us", kShallowUs);
}

Finding check_bus_power(const Subject& subject, Notes& notes) {
  State pcie = State::not_applicable, usb = State::not_applicable;
  std::string words;
  if (!has_no(subject, "/sys/module", "pcie_aspm")) {
    const std::string policy = chosen(notes.read("/sys/module/pcie_aspm/parameters/policy").value);
    pcie = policy.empty() ? State::unknown : policy == "performance" ? State::ok : State::warn;
    if (pcie == State::warn) words = fmt::format("PCIe links may sleep (policy {})", policy);
  }
  if (!has_no(subject, "/sys/module", "usbcore")) {
    const auto seconds = notes.number("/sys/module/usbcore/parameters/autosuspend");
    usb = !seconds ? State::unknown : *seconds < 0 ? State::ok : State::warn;
    if (usb == State::warn) words += std::string(words.empty() ? "" : "; ") + "USB devices may be suspended";
  }
  const State state = worst({pcie, usb});
  if (state == State::unknown) words = "not all of these settings can be read";
  if (state == State::not_applicable) {
    notes.add("/sys/module", "neither pcie_aspm nor usbcore");
    words = "this kernel has neither PCIe power saving nor USB";
  }
  return notes.say(state, words.empty() ? "PCIe and USB stay awake" : words);
}

Finding check_jetson_mode(const Subject& subject, Notes& notes) {
  const std::string path = "/var/lib/nvpmodel/status";
  const BoardKind board = board_of(subject.files);
  notes.read("/proc/device-tree/model");
  if (board == BoardKind::unknown) return notes.say(State::unknown, "it is not known what board this is");
  if (board != BoardKind::jetson) return notes.say(State::not_applicable, "not a Jetson");
  const Reading mode = notes.read(path);
  if (mode.value.empty()) return notes.unread(path);
  return notes.say(mode.value == "pmode:0000" ? State::ok : State::warn, "power mode " + mode.value);
}

constexpr Item kPowerItems[] = {
    {25, "governor", "The frequency is fixed",
     "a change of frequency stops the core for 10 to 100 us and slows the law",
     "echo performance > /sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor; the same value in scaling_min_freq "
     "and scaling_max_freq; Raspberry Pi: force_turbo=1 and a strong supply",
     kNow, check_governor},
    {26, "turbo", "The frequency does not depend on heat", "with turbo, hot and cold runs differ",
     "echo 1 > /sys/devices/system/cpu/intel_pstate/no_turbo, or echo 0 > /sys/devices/system/cpu/cpufreq/boost", kNow,
     check_turbo},
    {27, "idle_states", "The core wakes up fast", "no matter for a Spine that spins; a Spine that sleeps wakes up late",
     "echo 1 > /sys/devices/system/cpu/cpu{cpu}/cpuidle/stateN/disable for the deep states", kNow, check_idle_states},
    {28, "bus_power", "PCIe and USB stay awake",
     "adapters answer late after a sleep; what the firmware does beside the kernel (SMI) no file tells: hwlatdetect",
     "boot options pcie_aspm.policy=performance and usbcore.autosuspend=-1", kReboot, check_bus_power},
    {29, "jetson_mode", "Jetson: full power mode", "other modes switch cores off and limit the clock",
     "nvpmodel -m 0; jetson_clocks", kNow, check_jetson_mode},
};

}  // namespace

std::span<const Item> power_items() { return kPowerItems; }

}  // namespace lithe::host
