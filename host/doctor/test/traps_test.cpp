// SPDX-License-Identifier: Apache-2.0
// The traps of the checklist: what looks right and is not, and what cannot be known.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "host/doctor/item.hpp"
#include "host/test/machines_rig.hpp"

namespace lithe::host {
namespace {

class Traps : public ::testing::Test {
 protected:
  Finding find(const std::string& id) const {
    const Subject subject = read_subject(HostFiles(root_.path()), kJudged, measured_);
    const auto item =
        std::find_if(checklist().begin(), checklist().end(), [&](const Item& each) { return each.id == id; });
    EXPECT_NE(item, checklist().end()) << id;
    return item->check(subject);
  }
  State state(const std::string& id) const { return find(id).state; }
  void remove(const std::string& path) const { std::filesystem::remove_all(root_.path() + path); }
  void make_unreadable(const std::string& path) const {
    remove(path);
    std::filesystem::create_symlink(root_.path() + path, root_.path() + path);
  }

  const FakeRoot root_;
  std::optional<Measured> measured_;
};

bool says(const Finding& finding, const std::string& part) { return finding.words.find(part) != std::string::npos; }

TEST_F(Traps, IsolcpusWithTheFlagNohzIsDroppedByAKernelWithoutIt) {
  put_pi(root_);
  const Finding finding = find("domain_isolation");
  EXPECT_EQ(finding.state, State::fail);
  EXPECT_TRUE(says(finding, "CONFIG_NO_HZ_FULL drops all of isolcpus=nohz,domain,1")) << finding.words;
  EXPECT_EQ(state("tickless"), State::warn) << "the file nohz_full is absent";
}

TEST_F(Traps, IsolationIsFoundInThePartitionTheRootAndTheSchedulersStatistics) {
  put_desktop(root_);
  EXPECT_EQ(state("domain_isolation"), State::fail);
  root_.write("/proc/schedstat", "version 15\ncpu0 0 0\ndomain0 d 0\ncpu1 0 0\ncpu2 0 0\ndomain0 d 0\n");
  EXPECT_EQ(state("domain_isolation"), State::ok);
  root_.write("/sys/devices/system/cpu/online", "1");
  EXPECT_EQ(state("domain_isolation"), State::fail) << "a machine of one core has no domains either";
}

TEST_F(Traps, TheLastCoreThatIsNotIsolatedHasNoDomainEither) {
  put_desktop(root_);
  root_.write("/proc/schedstat", "version 15\ncpu0 0 0\ncpu1 0 0\ncpu2 0 0\ncpu3 0 0\n");
  EXPECT_EQ(state("domain_isolation"), State::unknown) << "it may be any of them";
  root_.write("/sys/devices/system/cpu/isolated", "0,2-3");
  EXPECT_EQ(state("domain_isolation"), State::fail);
  EXPECT_TRUE(says(find("domain_isolation"), "core 1 is the last one that is not isolated"));
  // The others are in a partition that has a domain of its own.
  root_.write("/sys/devices/system/cpu/isolated", "0");
  root_.write("/proc/schedstat", "version 15\ncpu0 0 0\ncpu1 0 0\ncpu2 0 0\ndomain0 c 0\ncpu3 0 0\ndomain0 c 0\n");
  EXPECT_EQ(state("domain_isolation"), State::ok) << "nothing says where the tasks run";
  root_.write("/sys/fs/cgroup/planner/cpuset.cpus", "2-3");
  root_.write("/sys/fs/cgroup/planner/cpuset.cpus.effective", "2-3");
  root_.write("/sys/fs/cgroup/planner/cpuset.cpus.partition", "root");
  EXPECT_EQ(state("domain_isolation"), State::fail) << "they run here";
  root_.write("/sys/fs/cgroup/planner/cpuset.cpus.partition", "member");
  root_.write("/proc/schedstat", "version 15\ncpu0 0 0\ncpu1 0 0\ncpu2 0 0\ncpu3 0 0\n");
  // Two cores and a shield of cgroup v1: no core has a domain, and one of them is free.
  root_.write("/sys/devices/system/cpu/isolated", "");
  root_.write("/sys/devices/system/cpu/online", "0-1");
  remove("/sys/fs/cgroup/cgroup.controllers");
  root_.write("/sys/fs/cgroup/cpuset/cpuset.sched_load_balance", "0");
  root_.write("/sys/fs/cgroup/cpuset/lithe.rest/cpuset.cpus", "0");
  root_.write("/sys/fs/cgroup/cpuset/lithe.rest/cpuset.sched_load_balance", "1");
  EXPECT_EQ(state("domain_isolation"), State::ok);
  root_.write("/sys/fs/cgroup/cpuset/lithe.rest/cpuset.cpus", "1");
  EXPECT_EQ(state("domain_isolation"), State::unknown);
  root_.write("/sys/fs/cgroup/cpuset/lithe.rest/cpuset.cpus", "0");
  make_unreadable("/sys/fs/cgroup/cpuset/lithe.rest/cpuset.cpus");
  EXPECT_EQ(state("domain_isolation"), State::unknown) << "the group may have the core";
}

TEST_F(Traps, TwoSpinesOnOneCoreFailWithBothPids) {
  put_partition(root_);
  add_task(root_, {.pid = 600, .name = "lithe-spine-sim", .cpus = "1"});
  EXPECT_EQ(state("spine_pinned"), State::ok);
  add_task(root_, {.pid = 700, .name = "lithe-spine", .cpus = "1"});
  EXPECT_EQ(state("spine_pinned"), State::fail);
  EXPECT_TRUE(says(find("spine_pinned"), "pids 600, 700")) << find("spine_pinned").words;
  remove("/proc/700");
  remove("/proc/2");
  EXPECT_EQ(state("spine_pinned"), State::unknown) << "another one may run unseen";
}

TEST_F(Traps, APartitionThatTheKernelCallsInvalidIsolatesNothing) {
  put_partition(root_);
  EXPECT_EQ(state("isolated_partition"), State::ok);
  EXPECT_EQ(state("domain_isolation"), State::ok);
  root_.write("/sys/fs/cgroup/spine/cpuset.cpus.partition", "isolated invalid (Cpu list in cpuset.cpus not exclusive)");
  EXPECT_EQ(state("isolated_partition"), State::fail);
  EXPECT_EQ(state("domain_isolation"), State::fail);
  make_unreadable("/sys/fs/cgroup/spine/cpuset.cpus.partition");
  EXPECT_EQ(state("isolated_partition"), State::unknown);
  EXPECT_EQ(state("domain_isolation"), State::unknown);
}

TEST_F(Traps, AShieldOfCgroupV1WithTasksLeftBehindIsWorseThanNone) {
  put_fifo(root_);
  EXPECT_EQ(state("v1_shield"), State::fail);
  for (const int pid : {1, 2, 3, 400, 500}) {
    root_.write("/proc/" + std::to_string(pid) + "/task/" + std::to_string(pid) + "/status",
                "Cpus_allowed_list:\t0,2-3\n");
  }
  EXPECT_EQ(state("v1_shield"), State::ok);
  root_.write("/sys/fs/cgroup/cpuset/cpuset.sched_load_balance", "1");
  EXPECT_EQ(state("v1_shield"), State::warn);
}

TEST_F(Traps, ThreadsThatNobodyCanMoveDoNotCount) {
  put_pinned(root_);
  EXPECT_EQ(state("user_tasks"), State::ok);
  EXPECT_EQ(state("kernel_threads"), State::ok) << "ksoftirqd/1 is bound";
  add_task(root_, {.pid = 31, .name = "kcompactd0", .cpus = "0-3", .flags = kKernelThread});
  EXPECT_EQ(state("kernel_threads"), State::warn);
  EXPECT_EQ(state("user_tasks"), State::ok);
}

TEST_F(Traps, InAContainerTheTasksOfOthersAreUnknown) {
  put_pinned(root_);
  remove("/proc/2");
  EXPECT_EQ(state("user_tasks"), State::unknown);
  EXPECT_EQ(state("irqbalance"), State::warn) << "what is seen is there";
  EXPECT_EQ(state("memory_lock"), State::unknown) << "a Spine may run unseen";
}

TEST_F(Traps, AThrottledRealTimeSpineFailsAndAnOrdinaryOneDoesNotCare) {
  put_fifo(root_);
  EXPECT_EQ(state("rt_throttling"), State::fail);
  EXPECT_EQ(state("fair_server"), State::fail);
  root_.write("/proc/sys/kernel/sched_rt_runtime_us", "-1");
  EXPECT_EQ(state("rt_throttling"), State::ok);
  EXPECT_EQ(state("fair_server"), State::fail) << "the fair server works without throttling, too";
  make_unreadable("/sys/kernel/debug/sched/fair_server/cpu1/runtime");
  EXPECT_EQ(state("fair_server"), State::unknown);
  root_.write("/proc/sys/kernel/osrelease", "6.1.0");
  EXPECT_EQ(state("fair_server"), State::not_applicable);
  root_.write("/proc/sys/kernel/osrelease", "6.18.0");
  add_task(root_, {.pid = 600, .name = "lithe-spine", .cpus = "1"});
  EXPECT_EQ(state("fair_server"), State::not_applicable);
}

TEST_F(Traps, WhereTheControllerDoesNotTellTheCountersDecide) {
  put_pi(root_);
  EXPECT_EQ(state("irq_affinity"), State::unknown) << "7 interrupts of eth0 came to core 1, whatever its mask says";
  measured_ = Measured{};
  measured_->device_interrupts_per_s = 0.0;
  EXPECT_EQ(state("irq_affinity"), State::ok);
  measured_->device_interrupts_per_s = 3.0;
  EXPECT_EQ(state("irq_affinity"), State::fail);
  measured_->device_interrupts_per_s = std::nullopt;
  EXPECT_EQ(state("irq_affinity"), State::unknown);
}

TEST_F(Traps, AMaskThatCannotBeReadLeavesInterruptsUnknown) {
  put_partition(root_);
  EXPECT_EQ(state("irq_affinity"), State::ok);
  root_.write("/proc/irq/default_smp_affinity", "f");
  EXPECT_EQ(state("irq_affinity"), State::warn);
  make_unreadable("/proc/irq/24/effective_affinity_list");
  EXPECT_EQ(state("irq_affinity"), State::unknown);
}

TEST_F(Traps, AParkedThreadForCallbacksProvesNothing) {
  put_booted(root_);
  EXPECT_EQ(state("rcu_callbacks"), State::ok);
  // Since Linux 5.17 every core has its thread, once one core is named.
  root_.write("/proc/cmdline", "isolcpus=managed_irq,domain,1 rcu_nocbs=3");
  root_.write("/sys/devices/system/cpu/nohz_full", "");
  EXPECT_EQ(state("rcu_callbacks"), State::warn);
  root_.write("/proc/cmdline", "isolcpus=managed_irq,domain,1 rcu_nocbs=1,3");
  EXPECT_EQ(state("rcu_callbacks"), State::ok);
}

TEST_F(Traps, SinceLinux612TheOptionNohzFullProvesNothing) {
  put_booted(root_);
  EXPECT_EQ(state("tickless"), State::ok);
  root_.write("/proc/sys/kernel/osrelease", "6.12.0");
  EXPECT_EQ(state("tickless"), State::unknown);
  measured_ = Measured{};
  measured_->ticks_per_s = 0.2;
  EXPECT_EQ(state("tickless"), State::ok);
  measured_->ticks_per_s = 250;
  EXPECT_EQ(state("tickless"), State::fail);
}

TEST_F(Traps, WithAClockThatIsNotTheProcessorsTheTickMayStay) {
  put_booted(root_);
  const std::string clock = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
  root_.write(clock, "hpet\n");
  const Finding finding = find("tickless");
  EXPECT_EQ(finding.state, State::unknown);
  EXPECT_TRUE(std::any_of(finding.evidence.begin(), finding.evidence.end(),
                          [&](const Evidence& each) { return each.path == clock && each.value == "hpet"; }));
  measured_ = Measured{};
  measured_->ticks_per_s = 0.2;
  EXPECT_EQ(state("tickless"), State::ok);
  measured_.reset();
  remove(clock);
  EXPECT_EQ(state("tickless"), State::unknown);
}

TEST_F(Traps, APiWithAWeakSupplyIsNotFixed) {
  put_pi(root_);
  EXPECT_TRUE(says(find("governor"), "supply"));
  root_.write("/sys/class/hwmon/hwmon1/in0_lcrit_alarm", "0");
  EXPECT_EQ(state("governor"), State::ok);
  EXPECT_EQ(state("turbo"), State::not_applicable);
  EXPECT_EQ(state("jetson_mode"), State::not_applicable);
}

TEST_F(Traps, ADriverThatChoosesItselfNeedsAFixedRange) {
  put_booted(root_);
  EXPECT_EQ(state("governor"), State::ok);
  root_.write("/sys/devices/system/cpu/cpu1/cpufreq/scaling_driver", "intel_pstate");
  EXPECT_EQ(state("governor"), State::warn);
  root_.write("/sys/devices/system/cpu/cpu1/cpufreq/scaling_min_freq", "4000000");
  EXPECT_EQ(state("governor"), State::ok);
}

TEST_F(Traps, WithoutCpufreqThereIsNothingToSet) {
  put_booted(root_);
  remove("/sys/devices/system/cpu/cpu1/cpufreq");
  remove("/sys/devices/system/cpu/cpufreq");
  EXPECT_EQ(state("governor"), State::not_applicable);
  EXPECT_EQ(state("turbo"), State::not_applicable);
}

TEST_F(Traps, TheCapabilitiesOfAUserNamespaceLockNoMemory) {
  put_desktop(root_);
  EXPECT_EQ(state("memory_lock"), State::fail);
  root_.write("/proc/self/status", "CapEff:\t000001ffffffffff\n");
  EXPECT_EQ(state("memory_lock"), State::ok);
  root_.write("/proc/self/uid_map", "         0       1000          1\n");
  EXPECT_EQ(state("memory_lock"), State::fail);
}

TEST_F(Traps, ARunningSpineTellsWhetherItsMemoryIsLocked) {
  put_partition(root_);
  add_task(root_, {.pid = 600, .name = "lithe-spine-sim", .cpus = "1"});
  EXPECT_EQ(state("memory_lock"), State::fail);
  EXPECT_EQ(state("spine_pinned"), State::ok);
  add_task(root_, {.pid = 600, .name = "lithe-spine-sim", .cpus = "0-3", .locked = "90000 kB"});
  EXPECT_EQ(state("memory_lock"), State::ok);
  EXPECT_EQ(state("spine_pinned"), State::fail);
}

TEST_F(Traps, ALimitOfMemoryCountsOnEveryLevel) {
  put_desktop(root_);
  EXPECT_EQ(state("memory_limit"), State::ok);
  root_.write("/sys/fs/cgroup/user.slice/memory.high", "4000000000");
  EXPECT_EQ(state("memory_limit"), State::warn);
  put_fifo(root_);
  EXPECT_EQ(state("memory_limit"), State::warn);
  root_.write("/sys/fs/cgroup/memory/box/memory.limit_in_bytes", "9223372036854771712");
  EXPECT_EQ(state("memory_limit"), State::ok);
  root_.write("/proc/self/cgroup", "4:memory:/box/inner\n0::/");
  root_.write("/sys/fs/cgroup/memory/box/inner/memory.limit_in_bytes", "9223372036854771712");
  EXPECT_EQ(state("memory_limit"), State::ok);
  root_.write("/sys/fs/cgroup/memory/box/memory.limit_in_bytes", "1000000");
  EXPECT_EQ(state("memory_limit"), State::warn);
}

TEST_F(Traps, WhatIrqbalanceWasToldIsUnknownToWhomItDoesNotBelong) {
  put_partition(root_);
  add_task(root_, {.pid = 400, .name = "irqbalance"});
  root_.write("/proc/400/environ", "IRQBALANCE_BANNED_CPULIST=0\n");
  EXPECT_EQ(state("irqbalance"), State::warn);
  make_unreadable("/proc/400/environ");
  EXPECT_EQ(state("irqbalance"), State::unknown);
}

TEST_F(Traps, AnAbsentFileIsNeverInOrder) {
  put_booted(root_);
  for (const auto& [id, path] : {std::pair{"vmstat", "/proc/sys/vm/stat_interval"},
                                 {"timer_migration", "/proc/sys/kernel/timer_migration"},
                                 {"swap", "/proc/swaps"},
                                 {"clocksource", "/sys/devices/system/clocksource/clocksource0/current_clocksource"},
                                 {"workqueues", "/sys/devices/virtual/workqueue/cpumask"},
                                 {"tracing", "/sys/kernel/tracing/set_event"},
                                 {"smt", "/sys/devices/system/cpu/cpu1/topology/thread_siblings_list"}}) {
    EXPECT_EQ(state(id), State::ok) << id;
    remove(path);
    EXPECT_NE(state(id), State::ok) << id;
  }
}

}  // namespace
}  // namespace lithe::host
