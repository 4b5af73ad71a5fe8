// SPDX-License-Identifier: Apache-2.0
#include "host/test/machines_rig.hpp"

#include <initializer_list>
#include <utility>

namespace lithe::host {
namespace {

using Texts = std::initializer_list<std::pair<const char*, const char*>>;

void put(const FakeRoot& root, Texts files) {
  for (const auto& [path, text] : files) root.write(path, std::string(text) + "\n");
}

void put_settings(const FakeRoot& root) {
  put(root, {{"/proc/sys/kernel/osrelease", "6.1.0-56-amd64"},
             {"/proc/sys/kernel/sched_rt_runtime_us", "950000"},
             {"/proc/sys/kernel/timer_migration", "1"},
             {"/proc/sys/kernel/watchdog", "1"},
             {"/proc/sys/kernel/nmi_watchdog", "1"},
             {"/proc/sys/kernel/watchdog_cpumask", "0-3"},
             {"/proc/sys/kernel/numa_balancing", "0"},
             {"/proc/sys/kernel/randomize_va_space", "2"},
             {"/proc/sys/vm/stat_interval", "1"},
             {"/proc/sys/vm/dirty_writeback_centisecs", "500"},
             {"/proc/sys/vm/compaction_proactiveness", "20"},
             {"/proc/sys/vm/swappiness", "60"},
             {"/proc/swaps", "Filename Type Size Used Priority\n/dev/sda2 partition 1000 0 -2"},
             {"/proc/self/mounts", "proc /proc proc rw 0 0\ntmpfs /dev/shm tmpfs rw,nosuid 0 0"},
             {"/proc/self/status", "Name:\tlithe\nCapEff:\t0000000000000000"},
             {"/proc/self/uid_map", "         0          0 4294967295"},
             {"/proc/self/limits", "Limit Soft Hard Units\nMax locked memory 8388608 8388608 bytes"},
             {"/proc/self/cgroup", "0::/user.slice/shell"},
             {"/proc/cmdline", "root=/dev/sda1 quiet"},
             {"/proc/schedstat", "version 15\ncpu0 0 0\ndomain0 f 0\ncpu1 0 0\ndomain0 f 0\ncpu2 0 0\ndomain0 f 0"},
             {"/proc/stat", "cpu  1 2 3 4 5 6 7 0 0 0\ncpu0 1 2 3 4 5 6 7 0 0 0\ncpu1 1 2 3 4 5 6 7 0 0 0"}});
}

void put_devices(const FakeRoot& root) {
  put(root, {{"/sys/devices/virtual/workqueue/cpumask", "f"},
             {"/sys/devices/system/cpu/online", "0-3"},
             {"/sys/devices/system/cpu/isolated", ""},
             {"/sys/devices/system/cpu/nohz_full", "(null)"},
             {"/sys/devices/system/cpu/cpu1/topology/thread_siblings_list", "1,3"},
             {"/sys/devices/system/cpu/cpu1/topology/core_id", "1"},
             {"/sys/devices/system/clocksource/clocksource0/current_clocksource", "hpet"},
             {"/sys/devices/system/node/online", "0-1"},
             {"/sys/devices/system/node/possible", "0-1"},
             {"/sys/kernel/mm/transparent_hugepage/enabled", "[always] madvise never"},
             {"/sys/kernel/mm/transparent_hugepage/defrag", "always"},
             {"/sys/kernel/mm/ksm/run", "0"},
             {"/sys/kernel/mm/ksm/pages_shared", "0"},
             {"/sys/kernel/tracing/current_tracer", "nop"},
             {"/sys/kernel/tracing/set_event", ""},
             {"/sys/module/pcie_aspm/parameters/policy", "[default] performance powersave"},
             {"/sys/module/usbcore/parameters/autosuspend", "2"},
             {"/sys/fs/cgroup/cgroup.controllers", "cpuset cpu memory"},
             {"/sys/fs/cgroup/user.slice/cgroup.controllers", "cpuset memory"},
             {"/sys/fs/cgroup/user.slice/cgroup.events", "populated 1"},
             {"/sys/fs/cgroup/user.slice/memory.high", "max"},
             {"/sys/fs/cgroup/user.slice/memory.max", "max"},
             {"/sys/fs/cgroup/user.slice/shell/cgroup.controllers", "memory"},
             {"/sys/fs/cgroup/user.slice/shell/cgroup.events", "populated 1"},
             {"/sys/fs/cgroup/user.slice/shell/memory.high", "max"},
             {"/sys/fs/cgroup/user.slice/shell/memory.max", "max"}});
}

void put_pc(const FakeRoot& root) {
  put(root, {{"/proc/cpuinfo", "processor\t: 0\nvendor_id\t: GenuineIntel\nflags\t\t: fpu tsc cat_l3"},
             {"/proc/interrupts",
              "            CPU0  CPU1  CPU2  CPU3\n"
              " 24:      10  20  0  0  PCI-MSI 1-edge  eth0\n"
              "LOC:     100 200 300 400  Local timer interrupts\n"
              "RES:       1   2   3   4  Rescheduling interrupts"},
             {"/proc/irq/24/smp_affinity_list", "0-3"},
             {"/proc/irq/24/effective_affinity_list", "1"},
             {"/proc/irq/default_smp_affinity", "f"},
             {"/sys/devices/system/cpu/cpufreq/boost", "1"},
             {"/sys/devices/system/cpu/cpufreq/policy1/scaling_governor", "powersave"},
             {"/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave"},
             {"/sys/devices/system/cpu/cpu1/cpufreq/scaling_driver", "intel_cpufreq"},
             {"/sys/devices/system/cpu/cpu1/cpufreq/scaling_min_freq", "800000"},
             {"/sys/devices/system/cpu/cpu1/cpufreq/scaling_max_freq", "4000000"},
             {"/sys/devices/system/cpu/cpuidle/current_driver", "intel_idle"},
             {"/sys/devices/system/cpu/cpu1/cpuidle/state0/name", "POLL"},
             {"/sys/devices/system/cpu/cpu1/cpuidle/state0/latency", "0"},
             {"/sys/devices/system/cpu/cpu1/cpuidle/state0/disable", "0"},
             {"/sys/devices/system/cpu/cpu1/cpuidle/state1/name", "C6"},
             {"/sys/devices/system/cpu/cpu1/cpuidle/state1/latency", "133"},
             {"/sys/devices/system/cpu/cpu1/cpuidle/state1/disable", "0"},
             {"/sys/devices/system/machinecheck/machinecheck1/check_interval", "300"},
             {"/sys/devices/system/machinecheck/machinecheck1/ignore_ce", "0"},
             {"/sys/fs/resctrl/schemata", "L3:0=fff"},
             {"/sys/fs/resctrl/cpus_list", "0-3"}});
}

void put_tasks(const FakeRoot& root, const std::string& movable) {
  add_task(root, {.pid = 1, .name = "systemd", .cpus = movable});
  add_task(root, {.pid = 2, .name = "kthreadd", .cpus = movable, .flags = kKernelThread});
  add_task(root, {.pid = 3, .name = "rcu_preempt", .cpus = movable, .flags = kKernelThread});
  add_task(root, {.pid = 20, .name = "ksoftirqd/1", .cpus = "1", .flags = kBoundThread});
  add_task(root, {.pid = 400, .name = "irqbalance", .cpus = movable});
  root.write("/proc/400/environ", "LANG=C");
  add_task(root, {.pid = 500, .name = "my (odd) app", .cpus = movable});
}

// What can be set while the machine runs, as it should be.
void mend(const FakeRoot& root) {
  put(root, {{"/proc/irq/24/smp_affinity_list", "0,2-3"},
             {"/proc/irq/24/effective_affinity_list", "0"},
             {"/proc/irq/default_smp_affinity", "d"},
             {"/sys/devices/virtual/workqueue/cpumask", "d"},
             {"/proc/self/limits", "Limit Soft Hard Units\nMax locked memory unlimited unlimited bytes"},
             {"/proc/sys/kernel/timer_migration", "0"},
             {"/proc/sys/kernel/watchdog_cpumask", "0,2-3"},
             {"/proc/sys/vm/stat_interval", "10"},
             {"/proc/sys/vm/compaction_proactiveness", "0"},
             {"/proc/sys/vm/swappiness", "10"},
             {"/sys/devices/system/cpu/cpu1/topology/thread_siblings_list", "1"},
             {"/sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc"},
             {"/sys/kernel/mm/transparent_hugepage/enabled", "always [madvise] never"}});
  root.write("/proc/400/environ", std::string("LANG=C\0IRQBALANCE_BANNED_CPULIST=1\0", 36));
}

}  // namespace

void add_task(const FakeRoot& root, const FakeTask& task) {
  const std::string pid = std::to_string(task.pid), folder = "/proc/" + pid;
  // Fields 3 to 41 of proc_pid_stat: the state, and 38 numbers.
  std::string stat = pid + " (" + task.name + ") S";
  for (int field = 4; field <= 52; ++field)
    stat += field == 9 ? " " + std::to_string(task.flags) : field == 41 ? " " + std::to_string(task.policy) : " 0";
  root.write(folder + "/task/" + pid + "/stat", stat + "\n");
  root.write(folder + "/task/" + pid + "/status", "Name:\t" + task.name + "\nCpus_allowed_list:\t" + task.cpus + "\n");
  root.write(folder + "/status", "Name:\t" + task.name + "\nVmLck:\t    " + task.locked + "\n");
}

void put_desktop(const FakeRoot& root) {
  put_settings(root);
  put_devices(root);
  put_pc(root);
  put_tasks(root, "0-3");
}

void put_pinned(const FakeRoot& root) {
  put_desktop(root);
  put_tasks(root, "0,2-3");
}

void put_partition(const FakeRoot& root) {
  put_pinned(root);
  mend(root);
  put(root, {{"/sys/fs/cgroup/spine/cpuset.cpus", "1"},
             {"/sys/fs/cgroup/spine/cpuset.cpus.effective", "1"},
             {"/sys/fs/cgroup/spine/cpuset.cpus.partition", "isolated"}});
}

void put_booted(const FakeRoot& root) {
  put_pinned(root);
  mend(root);
  add_task(root, {.pid = 30, .name = "rcuop/1", .cpus = "0,2-3", .flags = kKernelThread});
  put(root, {{"/proc/cmdline", "isolcpus=managed_irq,domain,1 nohz_full=1 rcu_nocbs=1 skew_tick=1"},
             {"/sys/devices/system/cpu/isolated", "1"},
             {"/sys/devices/system/cpu/nohz_full", "1"},
             {"/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "performance"},
             {"/sys/devices/system/cpu/cpufreq/boost", "0"},
             {"/sys/devices/system/cpu/cpu1/cpuidle/state1/disable", "1"},
             {"/proc/schedstat", "version 15\ncpu0 0 0\ndomain0 d 0\ncpu1 0 0\ncpu2 0 0\ndomain0 d 0"}});
}

void put_pi(const FakeRoot& root) {
  put_settings(root);
  put_devices(root);
  put_tasks(root, "0,2-3");
  mend(root);
  put(root, {{"/proc/cpuinfo", "processor\t: 0\nFeatures\t: fp asimd\nCPU implementer\t: 0x41"},
             {"/proc/device-tree/model", "Raspberry Pi 5 Model B Rev 1.0"},
             {"/proc/cmdline", "isolcpus=nohz,domain,1 root=/dev/mmcblk0p2"},
             {"/proc/sys/kernel/osrelease", "6.12.20-v8+"},
             {"/proc/interrupts",
              "           CPU0       CPU1       CPU2       CPU3\n"
              " 11:       4000       4100       4200       4300    GICv2  30 Level     arch_timer\n"
              "106:       9000          7          0          0     rp1_irq_chip  6 Level     eth0\n"
              "IPI0:       100        200        300        400       Rescheduling interrupts\n"
              "IPI1:         1          2          3          4       Function call interrupts"},
             {"/proc/irq/106/smp_affinity_list", "0,2-3"},
             {"/proc/irq/106/effective_affinity_list", ""},
             {"/sys/devices/system/clocksource/clocksource0/current_clocksource", "arch_sys_counter"},
             {"/sys/devices/system/cpu/cpufreq/policy0/scaling_governor", "ondemand"},
             {"/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "performance"},
             {"/sys/devices/system/cpu/cpu1/cpufreq/scaling_driver", "cpufreq-dt"},
             {"/sys/devices/system/cpu/cpuidle/current_driver", "none"},
             {"/sys/class/hwmon/hwmon1/name", "rpi_volt"},
             {"/sys/class/hwmon/hwmon1/in0_lcrit_alarm", "1"}});
  std::filesystem::remove(root.path() + "/sys/devices/system/cpu/nohz_full");
  // One of each kind that may come to the core: when it cannot be read, nothing wrong is seen any more.
  add_task(root, {.pid = 31, .name = "kcompactd0", .cpus = "0-3", .flags = kKernelThread});
  add_task(root, {.pid = 501, .name = "stray", .cpus = "1-2"});
}

void put_fifo(const FakeRoot& root) {
  put_desktop(root);
  put(root, {{"/proc/cpuinfo", "vendor_id\t: GenuineIntel\nflags\t\t: fpu tsc hypervisor"},
             {"/proc/sys/kernel/osrelease", "6.18.0"},
             {"/proc/self/cgroup", "3:cpuset:/\n4:memory:/box\n0::/"},
             {"/sys/fs/cgroup/cpuset/cpuset.sched_load_balance", "0"},
             {"/sys/fs/cgroup/memory/box/memory.limit_in_bytes", "1000000"},
             {"/sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712"},
             {"/sys/kernel/debug/sched/fair_server/cpu1/runtime", "50000000"},
             // Its mask was changed, it still goes to core 1, and has not come yet.
             {"/proc/irq/24/smp_affinity_list", "0,2-3"},
             {"/proc/interrupts",
              "            CPU0  CPU1  CPU2  CPU3\n"
              " 24:      10  0  0  0  PCI-MSI 1-edge  eth0\n"
              "LOC:     100 200 300 400  Local timer interrupts"}});
  add_task(root, {.pid = 600, .name = "lithe-spine", .cpus = "1", .policy = 1});
}

}  // namespace lithe::host
