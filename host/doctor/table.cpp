// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cstdio>

#include "host/doctor/checks/checks.hpp"
#include "host/doctor/item.hpp"
#include "host/read/words.hpp"

namespace lithe::host {
namespace {

constexpr bool kReboot = true, kNow = false;

constexpr Item kScheduler[] = {
    {1, "domain_isolation", "The core is taken from the scheduler",
     "the kernel then moves no task to it: everything else on the machine stays off the Spine's core",
     "at run time: an isolated cpuset partition with core {cpu}; at boot: isolcpus=managed_irq,domain,{cpu} (no nohz "
     "in "
     "it unless the kernel has CONFIG_NO_HZ_FULL)",
     kNow, check_domain_isolation},
    {2, "isolated_partition", "Isolated partition of cgroup v2",
     "the same without a reboot; the kernel can make it invalid later without a word, for example after a core was off",
     "mkdir /sys/fs/cgroup/spine; write {cpu} to its cpuset.cpus, then isolated to its cpuset.cpus.partition", kNow,
     check_isolated_partition},
    {3, "v1_shield", "Shield of cgroup v1",
     "where cpusets belong to cgroup v1, balancing can be turned off; tasks left on the core then stay there for ever",
     "move every task to a cpuset of cores {others}, then write 0 to the root's cpuset.sched_load_balance", kNow,
     check_v1_shield},
    {4, "user_tasks", "User tasks stay off the core",
     "a task that may run there will run there as soon as the core looks idle",
     "taskset -acp {others} PID for each; for good: systemd CPUAffinity={others}", kNow, check_user_tasks},
    {5, "kernel_threads", "Movable kernel threads stay off the core",
     "threads such as rcu_preempt, kcompactd and khugepaged take the core for some 10 us",
     "taskset -cp {others} TID for each; kernel threads that start later may come back", kNow, check_kernel_threads},
    {6, "bound_kernel_threads", "Kernel threads bound to the core are quiet",
     "kworker/{cpu}, ksoftirqd/{cpu} and migration/{cpu} cannot be moved; only their causes can: items 7, 12, 20, 21",
     "mend items 7, 12, 20 and 21, then measure again", kNow, check_bound_kernel_threads},
    {7, "workqueues", "Unbound kernel work stays off the core", "write-back and the like take the core for some 10 us",
     "echo {others_mask} > /sys/devices/virtual/workqueue/cpumask", kNow, check_workqueues},
    {8, "spine_pinned", "The Spine is pinned to the core", "a Spine that moves loses its caches and meets other tasks",
     "[spine] cpu_spine = {cpu} in the robot file", kNow, check_spine_pinned},
    {9, "rt_throttling", "Real-time threads are not throttled",
     "a real-time thread that spins loses 50 ms of each second",
     "let the Spine be SCHED_OTHER, or sysctl kernel.sched_rt_runtime_us=-1", kNow, check_rt_throttling},
    {10, "fair_server", "The fair server is off",
     "since Linux 6.12 ordinary tasks get 50 ms of each second from a real-time thread, also without throttling",
     "let the Spine be SCHED_OTHER, or echo 0 > /sys/kernel/debug/sched/fair_server/cpu{cpu}/runtime", kNow,
     check_fair_server},
    {11, "smt", "No second thread on the same physical core",
     "a sibling shares the execution units and the first cache", "echo off > /sys/devices/system/cpu/smt/control", kNow,
     check_smt},
};

constexpr Item kInterrupts[] = {
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

constexpr Item kPowerAndMemory[] = {
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
    {30, "memory_lock", "The Spine's memory is locked", "else a tick can wait for a page: microseconds, or a disk",
     "LimitMEMLOCK=infinity in the unit, or '* - memlock unlimited' in /etc/security/limits.d", kNow,
     check_memory_lock},
    {31, "malloc", "malloc keeps its memory", "trimming and mapping change the page tables of all threads",
     "nothing to do", kNow, check_malloc},
    {32, "memory_scans", "The kernel does not scan or move memory",
     "huge pages, page merging, NUMA balancing and compaction interrupt every core that shares the memory",
     "echo madvise > /sys/kernel/mm/transparent_hugepage/enabled; echo 0 > /sys/kernel/mm/ksm/run; sysctl "
     "kernel.numa_balancing=0 vm.compaction_proactiveness=0",
     kNow, check_memory_scans},
    {33, "swap", "No swap, or hardly used", "the Brain waits for a disk in the middle of a plan",
     "swapoff -a, or sysctl vm.swappiness=10", kNow, check_swap},
    {34, "shared_memory", "Shared memory is memory", "Spine and Brain meet in /dev/shm",
     "mount -t tmpfs tmpfs /dev/shm", kNow, check_shared_memory},
    {35, "cache_partition", "The Spine has a part of the cache",
     "the Brain's data pushes the Spine's out; a small law stays in the first cache anyway",
     "mount -t resctrl resctrl /sys/fs/resctrl; a group with core {cpu} and its own schemata", kNow,
     check_cache_partition},
    {36, "memory_limit", "No memory limit for the robot's group",
     "at a limit the kernel takes memory back from the group, in the middle of what it does",
     "systemd: no MemoryHigh= and no MemoryMax= for the unit of lithe run", kNow, check_memory_limit},
    {37, "mitigations", "Address randomisation and mitigations",
     "they cost time at the start and at system calls; the tick makes none", "leave them on", kNow, check_mitigations},
};

constexpr std::size_t kItems = std::size(kScheduler) + std::size(kInterrupts) + std::size(kPowerAndMemory);

void replace_all(std::string& text, const std::string& name, const std::string& value) {
  for (std::size_t at = text.find(name); at != std::string::npos; at = text.find(name, at + value.size()))
    text.replace(at, name.size(), value);
}

}  // namespace

const char* word(State state) {
  constexpr std::array kWords = {"ok", "not_applicable", "unknown", "warn", "fail"};
  return kWords.at(static_cast<std::size_t>(state));
}

std::span<const Item> checklist() {
  static const std::array<Item, kItems> all = [] {
    std::array<Item, kItems> joined;
    auto at = std::copy(std::begin(kScheduler), std::end(kScheduler), joined.begin());
    at = std::copy(std::begin(kInterrupts), std::end(kInterrupts), at);
    std::copy(std::begin(kPowerAndMemory), std::end(kPowerAndMemory), at);
    return joined;
  }();
  return all;
}

std::string for_core(const char* text, const Subject& subject) {
  std::vector<int> others = subject.online;
  others.erase(std::remove(others.begin(), others.end(), subject.cpu), others.end());
  std::string words = text;
  replace_all(words, "{cpu}", std::to_string(subject.cpu));
  replace_all(words, "{others}", others.empty() ? "OTHERS" : cpu_list(others));
  replace_all(words, "{others_mask}", others.empty() ? "MASK" : mask_of(others));
  return words;
}

Subject read_subject(const HostFiles& files, int cpu, std::optional<Measured> measured) {
  Subject subject;
  subject.files = files;
  subject.cpu = cpu;
  subject.online = parse_cpu_list(files.read("/sys/devices/system/cpu/online").value);
  subject.isolated = isolated_cores(0, files.root());
  subject.tasks = read_tasks(files);
  subject.measured = std::move(measured);
  return subject;
}

}  // namespace lithe::host
