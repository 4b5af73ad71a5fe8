// SPDX-License-Identifier: Apache-2.0
// Items 19 to 24: what the kernel does on a core on its own account, and the clock.
#include <fmt/format.h>

#include <string>
#include <vector>

#include "host/doctor/item.hpp"
#include "host/read/words.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr double kCoreInterruptsPerS = 10;
constexpr long long kVmstatS = 10;
constexpr long long kWritebackCs = 1500;

// The kernel's periodic write-back is unbound work: harmless where that stays on other cores, or where it is rare.
State judge_writeback(const Subject& subject, Notes& notes) {
  const std::optional<long long> centiseconds = notes.number("/proc/sys/vm/dirty_writeback_centisecs");
  if (centiseconds && (*centiseconds == 0 || *centiseconds >= kWritebackCs)) return State::ok;
  const auto work = parse_mask(notes.read("/sys/devices/virtual/workqueue/cpumask").value);
  if (work && !contains(*work, subject.cpu)) return State::ok;
  return work && centiseconds ? State::warn : State::unknown;
}

// x86 asks its memory for errors every five minutes, on each core.
State judge_machine_check(const Subject& subject, Notes& notes) {
  if (has_no(subject, "/sys/devices/system", "machinecheck")) {
    notes.add("/sys/devices/system/machinecheck", "(absent)");
    return State::not_applicable;
  }
  const std::optional<long long> seconds =
      notes.number(fmt::format("/sys/devices/system/machinecheck/machinecheck{}/check_interval", subject.cpu));
  return !seconds ? State::unknown : *seconds == 0 ? State::ok : State::warn;
}

Finding check_watchdogs(const Subject& subject, Notes& notes) {
  const std::string on_path = "/proc/sys/kernel/watchdog";
  const std::string cores_path = "/proc/sys/kernel/watchdog_cpumask";
  const std::optional<long long> on = notes.number(on_path);
  const std::vector<int> cores = parse_cpu_list(notes.read(cores_path).value);
  notes.read("/proc/sys/kernel/nmi_watchdog");
  if (on == 0) return notes.say(State::ok, "the kernel's watchdogs are off");
  if (!cores.empty() && !contains(cores, subject.cpu))
    return notes.say(State::ok, "the watchdogs leave the core alone");
  if (!on || cores.empty()) return notes.unread(on ? cores_path : on_path);
  return notes.say(State::warn, "a watchdog of the kernel wakes up on the core");
}

Finding check_vmstat(const Subject&, Notes& notes) {
  const std::string path = "/proc/sys/vm/stat_interval";
  const std::optional<long long> seconds = notes.number(path);
  if (!seconds) return notes.unread(path);
  return notes.say(*seconds >= kVmstatS ? State::ok : State::warn,
                   "memory statistics are gathered every {} s, on each core", *seconds);
}

Finding check_periodic_work(const Subject& subject, Notes& notes) {
  const State write_back = judge_writeback(subject, notes), machine_check = judge_machine_check(subject, notes);
  const State state = worst({write_back, machine_check});
  if (state == State::unknown) return notes.say(state, "not all of these settings can be read");
  if (state != State::warn) return notes.say(state, "neither write-back nor memory checks come to the core often");
  std::string words = write_back == State::warn ? "write-back of files may run on the core" : "";
  if (machine_check == State::warn) words += std::string(words.empty() ? "" : "; ") + "memory checks run on the core";
  return notes.say(state, words);
}

Finding check_core_interrupts(const Subject& subject, Notes& notes) {
  if (!subject.measured || !subject.measured->core_interrupts_per_s)
    return notes.say(State::unknown, "only a measurement tells: lithe doctor --measure 10");
  const double rate = *subject.measured->core_interrupts_per_s;
  notes.add("--measure", "{:.1f} interrupts/s from other cores", rate);
  return notes.say(rate <= kCoreInterruptsPerS ? State::ok : State::warn,
                   "other cores interrupted it {:.1f} times a second", rate);
}

Finding check_tracing(const Subject& subject, Notes& notes) {
  const std::string top = "/sys/kernel/tracing";
  std::vector<std::string> folders{top};  // a trace of its own, also one that a killed program left, is an instance
  for (const std::string& each : subject.files.list(top + "/instances")) folders.push_back(top + "/instances/" + each);
  std::string unread;
  for (const std::string& folder : folders) {
    const Reading tracer = notes.read(folder + "/current_tracer"), events = notes.read(folder + "/set_event");
    const std::string where = folder == top ? "" : " in " + folder;
    if (tracer.known() && tracer.value != "nop" && !tracer.value.empty())
      return notes.say(State::warn, "tracer " + tracer.value + " is on" + where);
    if (!events.value.empty()) return notes.say(State::warn, "events are being traced" + where);
    if (tracer.value.empty()) unread = folder + "/current_tracer";
    if (!events.known()) unread = folder + "/set_event";
  }
  return unread.empty() ? notes.say(State::ok, "nothing is being traced") : notes.unread(unread);
}

Finding check_clocksource(const Subject&, Notes& notes) {
  const std::string path = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
  const std::string name = notes.read(path).value;
  if (name.empty()) return notes.unread(path);
  if (name == "tsc" || name == "arch_sys_counter") return notes.say(State::ok, "the clock is read without the kernel");
  const bool slow = name == "hpet" || name == "acpi_pm" || name == "jiffies" || name == "refined-jiffies";
  return notes.say(slow ? State::fail : State::warn, "clock source {}{}", name,
                   slow ? ": each reading costs a microsecond or more" : "");
}

constexpr Item kKernelNoiseItems[] = {
    {19, "watchdogs", "The kernel's watchdogs leave the core alone", "a thread and a counter interrupt wake up there",
     "sysctl kernel.watchdog_cpumask={others}", kNow, check_watchdogs},
    {20, "vmstat", "Memory statistics are gathered rarely", "a worker on each core, every interval",
     "sysctl vm.stat_interval=10", kNow, check_vmstat},
    {21, "periodic_work", "Write-back and memory checks leave the core alone", "work of 10 to 100 us on the core",
     "mend item 7, or sysctl vm.dirty_writeback_centisecs=1500; x86: echo 0 > "
     "/sys/devices/system/machinecheck/machinecheck{cpu}/check_interval",
     kNow, check_periodic_work},
    {22, "core_interrupts", "Other cores interrupt this one rarely",
     "shared memory maps, membarrier and scheduling send interrupts of 2 to 11 us from core to core",
     "stop what maps and unmaps memory in a process that has a thread on the core", kNow, check_core_interrupts},
    {23, "tracing", "Nothing is being traced", "turning a trace on or off stops all cores for a moment",
     "echo nop > /sys/kernel/tracing/current_tracer; echo > /sys/kernel/tracing/set_event", kNow, check_tracing},
    {24, "clocksource", "The clock is read without the kernel", "else each reading of the time is a slow call",
     "boot option tsc=reliable, only where the processor has constant_tsc and nonstop_tsc", kReboot, check_clocksource},
};

}  // namespace

std::span<const Item> kernel_noise_items() { return kKernelNoiseItems; }

}  // namespace lithe::host
