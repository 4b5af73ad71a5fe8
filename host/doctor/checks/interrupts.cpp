// SPDX-License-Identifier: Apache-2.0
// Items 12 to 18: device interrupts and the timer tick.
#include <fmt/format.h>

#include <algorithm>

#include "host/doctor/item.hpp"
#include "host/read/machine.hpp"
#include "host/read/words.hpp"
#include "spine/core/host/interrupts.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr const char* kTable = "/proc/interrupts";
constexpr const char* kDefaultMask = "/proc/irq/default_smp_affinity";
constexpr const char* kTickless = "/sys/devices/system/cpu/nohz_full";
constexpr const char* kClock = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
constexpr double kTicksPerS = 4;  // a core without a tick has 1 or 2
constexpr std::pair<int, int> kTickMayReturnSince = {6, 12};
constexpr double kSpinePhaseUs = 500;  // [spine] phase_ns, unless the robot file says otherwise
constexpr double kMsUs = 1000;

// Some controllers do not tell where an interrupt goes: effective_affinity_list is empty (Raspberry Pi 5), and its mask
// may be without effect. Then only the counters know. A file that is absent says nothing at all.
Finding judge_untold(const Subject& subject, const CoreInterrupts& counts, Notes& notes) {
  std::uint64_t since_boot = 0;
  for (const DeviceCount& each : counts.devices) {
    const std::string path = fmt::format("/proc/irq/{}/effective_affinity_list", each.number);
    const Reading effective = subject.files.read(path);
    if (effective.known() && !effective.value.empty()) continue;
    notes.add(path, effective.known() ? "(empty)" : shown(effective));
    if (!effective.known()) return notes.say(State::unknown, "it cannot be read where some interrupts go");
    since_boot += each.count;
  }
  if (since_boot == 0 || (subject.measured && subject.measured->device_interrupts_per_s == 0.0))
    return notes.say(State::ok, "no device interrupts core {}", subject.cpu);
  notes.add(kTable, "{} of these on core {} since the boot", since_boot, subject.cpu);
  return notes.say(State::unknown,
                   "the controller does not tell where interrupts go: lithe doctor --measure 10 counts them");
}

// Words of a kernel option, "rcu_nocbs=1,3"; empty if it is not on the command line.
std::string option(const std::string& line, const std::string& name) {
  for (const std::string& each : split(line))
    if (each.starts_with(name + "=")) return each;
  return "";
}

Finding check_irq_affinity(const Subject& subject, Notes& notes) {
  const Result<CoreInterrupts> counts = count_interrupts(subject.files, subject.cpu);
  const Result<std::vector<Interrupt>> here = interrupts_of(subject.cpu, subject.files.root());
  if (!counts || !here) {
    notes.add(kTable, counts ? here.message() : counts.message());
    return notes.say(State::unknown, counts ? here.message() : counts.message());
  }
  notes.add(kTable, "{} devices; core {} had {} of their interrupts since the boot", counts->devices.size(),
            subject.cpu, counts->device_total());
  for (const Interrupt& each : *here) notes.read(fmt::format("/proc/irq/{}/effective_affinity_list", each.number));
  if (!here->empty()) return notes.say(State::fail, interrupt_words(here));
  if (subject.measured && subject.measured->device_interrupts_per_s.value_or(0) > 0) {
    notes.add("--measure", "{:.1f} device interrupts/s", *subject.measured->device_interrupts_per_s);
    return notes.say(State::fail, "the masks exclude the core, and devices interrupt it all the same");
  }
  if (Finding untold = judge_untold(subject, *counts, notes); untold.state != State::ok) return untold;
  const std::optional<std::vector<int>> later = parse_mask(notes.read(kDefaultMask).value);
  if (!later) return notes.unread(kDefaultMask);
  if (contains(*later, subject.cpu))
    return notes.say(State::warn, "a device that is added later may interrupt core {}", subject.cpu);
  return notes.say(State::ok, "no device interrupts core {}", subject.cpu);
}

Finding check_irqbalance(const Subject& subject, Notes& notes) {
  for (const Task& each : subject.tasks.all) {
    if (each.name != "irqbalance") continue;
    const std::string path = fmt::format("/proc/{}/environ", each.pid);
    constexpr std::string_view kKey = "IRQBALANCE_BANNED_CPULIST=";
    const Reading reading = subject.files.read(path);
    if (!reading.known()) return notes.unread(path);
    const std::string& environment = reading.value;
    const std::size_t at = environment.find(kKey);
    const std::string banned = at == std::string::npos ? "" : environment.c_str() + at + kKey.size();
    notes.add(path, banned.empty() ? "no IRQBALANCE_BANNED_CPULIST seen" : fmt::format("{}{}", kKey, banned));
    if (contains(parse_cpu_list(banned), subject.cpu))
      return notes.say(State::ok, "irqbalance leaves core {} alone", subject.cpu);
    return notes.say(State::warn, "irqbalance (pid {}) may move interrupts to the core", each.pid);
  }
  notes.add(kAllTasks, subject.tasks.is_whole() ? "no irqbalance" : subject.tasks.why_not_whole);
  if (!subject.tasks.is_whole()) return notes.say(State::unknown, subject.tasks.why_not_whole);
  return notes.say(State::ok, "irqbalance does not run");
}

Finding check_tickless(const Subject& subject, Notes& notes) {
  const Reading option = notes.read(kTickless);
  const bool counted = subject.measured && subject.measured->ticks_per_s;
  const double ticks_per_s = counted ? subject.measured->ticks_per_s.value_or(0) : 0;
  if (counted) notes.add("--measure", "{:.1f} timer interrupts/s", ticks_per_s);
  if (option.is_absent())
    return notes.say(State::warn, "the tick interrupts the core: this kernel was built without CONFIG_NO_HZ_FULL");
  if (!option.known()) return notes.unread(kTickless);
  if (!subject.isolated.is_tickless(subject.cpu)) return notes.say(State::warn, "the timer tick interrupts the core");
  if (counted && ticks_per_s > kTicksPerS)
    return notes.say(State::fail, "nohz_full names the core, and it has {:.0f} ticks a second", ticks_per_s);
  if (counted) return notes.say(State::ok, "the core has no timer tick");
  notes.read("/proc/sys/kernel/osrelease");
  const auto version = kernel_version(subject.files);
  if (!version || *version >= kTickMayReturnSince) {
    return notes.say(
        State::unknown,
        "nohz_full names the core, but kernels since 6.12 may tick there: lithe doctor --measure 10 counts");
  }
  // A TSC that the kernel does not trust is not its clock; then the tick stays on every core, to correct the time.
  const Reading clock = notes.read(kClock);
  if (!clock.known()) return notes.unread(kClock);
  if (clock.value != "tsc" && clock.value != "arch_sys_counter") {
    return notes.say(State::unknown,
                     "nohz_full names the core, but the clock is {}: where the kernel does not trust the processor's "
                     "counter, the tick stays; lithe doctor --measure 10 counts",
                     clock.value);
  }
  return notes.say(State::ok, "the core has no timer tick while one thread runs there");
}

Finding check_rcu_callbacks(const Subject& subject, Notes& notes) {
  const std::string suffix = fmt::format("/{}", subject.cpu);
  const std::string asked = option(subject.files.read(kCommandLine).value, "rcu_nocbs");
  // Since Linux 5.17 every core has such a thread once one core is named: it may be parked.
  const std::vector<int> named = parse_cpu_list(asked.substr(std::min(asked.find('=') + 1, asked.size())));
  const bool offloaded = subject.isolated.is_tickless(subject.cpu) || contains(named, subject.cpu);
  for (const Task& each : subject.tasks.all) {
    if (!each.is_kernel || !each.name.starts_with("rcuo") || !each.name.ends_with(suffix)) continue;
    notes.add(fmt::format("/proc/{}/task/{}/stat", each.pid, each.tid), each.name);
    if (!offloaded) break;
    return notes.say(State::ok, "a thread ({}) does the callbacks of the core", each.name);
  }
  if (!asked.empty()) notes.add(kCommandLine, asked);
  notes.add(kAllTasks, subject.tasks.is_whole() ? fmt::format("no rcuo*{}", suffix) : subject.tasks.why_not_whole);
  if (!subject.tasks.is_whole()) return notes.say(State::unknown, subject.tasks.why_not_whole);
  return notes.say(State::warn, "RCU callbacks run on the core itself");
}

Finding check_release_phase(const Subject& subject, Notes& notes) {
  if (!subject.measured || subject.measured->phase_share.empty())
    return notes.say(State::unknown, "only a measurement tells: lithe doctor --measure 10");
  const std::vector<double>& share = subject.measured->phase_share;
  if (subject.measured->gaps_per_s > 0 && std::ranges::all_of(share, [](double each) { return each == 0; })) {
    notes.add("--measure", "{:.1f} gaps/s, all above 500 us", subject.measured->gaps_per_s);
    return notes.say(State::unknown, "gaps above 500 us tell nothing about a phase");
  }
  const auto bins = share.size();
  const auto at = static_cast<std::size_t>(kSpinePhaseUs / kMsUs * static_cast<double>(bins));
  const double around = share[(at + bins - 1) % bins] + share[at % bins];
  notes.add("--measure", "quietest at {:.0f} us; {:.0f} % of the gap time within 50 us of {:.0f} us",
            subject.measured->quietest_phase_us, 100 * around, kSpinePhaseUs);
  const bool quiet = around <= 2.0 / static_cast<double>(bins);  // no more than an even spread has
  return notes.say(quiet ? State::ok : State::warn,
                   quiet ? "the Spine's phase of 500 us is quiet"
                         : fmt::format("another release phase is quieter: phase_ns = {:.0f}",
                                       1000 * subject.measured->quietest_phase_us));
}

Finding check_timer_migration(const Subject& subject, Notes& notes) {
  const std::string path = "/proc/sys/kernel/timer_migration";
  const std::optional<long long> value = notes.number(path);
  if (value == 0) return notes.say(State::ok, "timers stay where they were started");
  if (subject.isolated.is_tickless(subject.cpu)) {
    notes.read(kTickless);
    return notes.say(State::not_applicable, "a core without a tick gets no timers of others");
  }
  if (!value) return notes.unread(path);
  return notes.say(State::warn, "timers of other cores may move to this one");
}

Finding check_skew_tick(const Subject& subject, Notes& notes) {
  const Reading line = subject.files.read(kCommandLine);
  const std::string found = option(line.value, "skew_tick");
  notes.add(kCommandLine, line.known() ? (found.empty() ? "no skew_tick" : found) : shown(line));
  if (!line.known()) return notes.unread(kCommandLine);
  if (found == "skew_tick=1") return notes.say(State::ok, "the ticks of the cores are apart");
  return notes.say(State::warn, "all cores tick at the same time and wait for one lock");
}

constexpr Item kInterruptsItems[] = {
    {12, "irq_affinity", "Device interrupts stay off the core", "each takes the core for 2 to 20 us",
     "echo {others} > /proc/irq/NUMBER/smp_affinity_list, and echo {others_mask} > /proc/irq/default_smp_affinity; "
     "where it is refused: boot option isolcpus=managed_irq,domain,{cpu}",
     kNow, check_irq_affinity},
    {13, "irqbalance", "irqbalance leaves the core alone", "it undoes item 12 within seconds",
     "IRQBALANCE_BANNED_CPULIST={cpu} in /etc/default/irqbalance, or stop it", kNow, check_irqbalance},
    {14, "tickless", "No timer tick on the core", "100 to 1000 times a second, 4 to 7 us each",
     "boot option nohz_full={cpu}; without CONFIG_NO_HZ_FULL: keep the release off the tick (item 16)", kReboot,
     check_tickless},
    {15, "rcu_callbacks", "RCU callbacks run elsewhere", "they run in batches after the tick and lengthen it",
     "boot option rcu_nocbs={cpu}", kReboot, check_rcu_callbacks},
    {16, "release_phase", "Releases are off the tick", "a tick at the time of a release delays that release each time",
     "[spine] phase_ns in the robot file: what lithe doctor --measure 10 names", kNow, check_release_phase},
    {17, "timer_migration", "Timers of others do not come to the core", "each costs an interrupt",
     "sysctl kernel.timer_migration=0, before the load starts", kNow, check_timer_migration},
    {18, "skew_tick", "The cores tick one after the other", "ticks at the same time wait for one lock",
     "boot option skew_tick=1; measure item 16 again afterwards", kReboot, check_skew_tick},
};

}  // namespace

std::span<const Item> interrupts_items() { return kInterruptsItems; }

}  // namespace lithe::host
