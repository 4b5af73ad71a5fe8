// SPDX-License-Identifier: Apache-2.0
// Text of the kernel: words, masks, tables of interrupts, tasks, partitions, the kind of machine.
#include <gtest/gtest.h>

#include <vector>

#include "host/read/machine.hpp"
#include "host/read/tasks.hpp"
#include "host/read/words.hpp"
#include "host/test/machines_rig.hpp"
#include "spine/core/host/cores.hpp"

namespace lithe::host {
namespace {

using Cpus = std::vector<int>;

TEST(Words, AreReadAsTheKernelWritesThem) {
  EXPECT_EQ(field_of("a\t: 1\nmodel name\t: x y \n", "model name"), "x y");
  EXPECT_EQ(field_of("a: 1", "b"), "");
  EXPECT_EQ(chosen("always [madvise] never"), "madvise");
  EXPECT_EQ(chosen("] ["), "");
  EXPECT_EQ(value_in_force("always [madvise] never"), "madvise");
  EXPECT_EQ(value_in_force("performance"), "performance");
  EXPECT_EQ(value_in_force("]odd["), "]odd[");
}

TEST(Mask, HasThirtyTwoCoresAGroup) {
  EXPECT_EQ(parse_mask("b"), (Cpus{0, 1, 3}));
  EXPECT_EQ(parse_mask("1,00000002"), (Cpus{1, 32}));
  for (const char* none : {"", "x", "1,", "123456789"}) EXPECT_EQ(parse_mask(none), std::nullopt) << none;
  for (const char* same : {"0", "d", "1,00000002", "ff,ffffffff"}) EXPECT_EQ(mask_of(*parse_mask(same)), same);
}

TEST(Mask, KeepsTheWidthOfAnother) {
  EXPECT_EQ(mask_of({0, 32}, "ffffffff,ffffffff"), "00000001,00000001");
  EXPECT_EQ(mask_of({4}, "f"), "") << "core 4 does not fit into one digit";
  for (const char* mask : {"1", "3", "d", "0f", "00000000,80000001", "ffffffff"})
    EXPECT_EQ(mask_of(*parse_mask(mask), mask), mask);
}

TEST(Cores, AreTakenOutOfAList) {
  EXPECT_EQ(cores_without({0, 1, 2}, {1}), (Cpus{0, 2}));
  EXPECT_TRUE(share_a_core({0, 1}, {1}));
  EXPECT_FALSE(share_a_core({0, 2}, {1, 3}));
}

TEST(InterruptCounts, HaveTheirColumnOnX86) {
  const FakeRoot root;
  put_desktop(root);
  const Result<CoreInterrupts> counts = count_interrupts(HostFiles(root.path()), 1);
  ASSERT_TRUE(counts) << counts.message();
  EXPECT_EQ(counts->timer, 200U);
  EXPECT_EQ(counts->cores, 2U);
  ASSERT_EQ(counts->devices.size(), 1U);
  EXPECT_EQ(counts->devices[0].name, "eth0");
  EXPECT_EQ(counts->device_total(), 20U);
}

TEST(InterruptCounts, HaveOtherRowsOnArm) {
  const FakeRoot root;
  put_pi(root);
  const Result<CoreInterrupts> counts = count_interrupts(HostFiles(root.path()), 1);
  ASSERT_TRUE(counts) << counts.message();
  EXPECT_EQ(counts->timer, 4100U);
  EXPECT_EQ(counts->cores, 202U);
  EXPECT_EQ(counts->device_total(), 7U);
}

TEST(InterruptCounts, OfACoreWithoutAColumnAreAnError) {
  const FakeRoot root;
  put_desktop(root);
  EXPECT_FALSE(count_interrupts(HostFiles(root.path()), 9));
}

TEST(TaskScan, ReadsNamesWithBracketsAndTellsWhenItIsNotWhole) {
  const FakeRoot root;
  put_desktop(root);
  const Tasks tasks = read_tasks(HostFiles(root.path()));
  EXPECT_TRUE(tasks.is_whole()) << tasks.why_not_whole;
  EXPECT_EQ(tasks.all.size(), 6U);
  EXPECT_EQ(tasks.all.back().name, "my (odd) app");
  EXPECT_TRUE(tasks.all.back().may_run_on(1));
  std::filesystem::remove(root.path() + "/proc/500/task/500/status");
  EXPECT_FALSE(read_tasks(HostFiles(root.path())).is_whole());
  std::filesystem::remove_all(root.path() + "/proc/500");
  EXPECT_TRUE(read_tasks(HostFiles(root.path())).is_whole()) << "a process that has ended is no gap";
}

TEST(TaskScan, OfAContainerIsNotWhole) {
  const FakeRoot root;
  add_task(root, {.pid = 1, .name = "init"});
  EXPECT_FALSE(read_tasks(HostFiles(root.path())).is_whole());
}

TEST(Partitions, AreFoundBelowBothMounts) {
  const FakeRoot root;
  put_partition(root);
  const std::vector<Partition> found = read_partitions(HostFiles(root.path()));
  ASSERT_EQ(found.size(), 1U);
  EXPECT_TRUE(found[0].is_isolated());
  EXPECT_EQ(found[0].cpus, Cpus{1});
  const FakeRoot hybrid;
  hybrid.write("/sys/fs/cgroup/unified/cgroup.controllers", "");
  EXPECT_EQ(cgroup2_folder(HostFiles(hybrid.path())), "/sys/fs/cgroup/unified");
}

TEST(Machine, IsKnownByWhatItSays) {
  const FakeRoot pc, pi, none;
  put_fifo(pc);
  put_pi(pi);
  EXPECT_EQ(board_of(HostFiles(pc.path())), BoardKind::x86);
  EXPECT_EQ(board_of(HostFiles(pi.path())), BoardKind::raspberry_pi);
  EXPECT_EQ(board_of(HostFiles(none.path())), BoardKind::unknown);
  EXPECT_EQ(hypervisor_of(HostFiles(pc.path())).present, true);
  EXPECT_EQ(hypervisor_of(HostFiles(pi.path())).present, false);
  EXPECT_EQ(hypervisor_of(HostFiles(none.path())).present, std::nullopt);
  EXPECT_EQ(kernel_version(HostFiles(pi.path())), (std::pair{6, 12}));
}

TEST(Machine, TellsARealTimeKernelFromAnotherAndFromOneThatCannotBeRead) {
  const FakeRoot root;
  EXPECT_EQ(kernel_facts(HostFiles(root.path())).words(), "of unknown release, PREEMPT_RT or not is unknown");
  root.write("/proc/sys/kernel/osrelease", "6.1.0-18-rt-amd64\n");
  root.write("/proc/sys/kernel/version", "#1 SMP PREEMPT_RT Debian 6.1.76-1 (2024-02-01)\n");
  EXPECT_EQ(kernel_facts(HostFiles(root.path())).words(), "6.1.0-18-rt-amd64, PREEMPT_RT");
  root.write("/proc/sys/kernel/version", "#1 SMP PREEMPT_DYNAMIC Debian 6.1.76-1 (2024-02-01)\n");
  EXPECT_EQ(kernel_facts(HostFiles(root.path())).words(), "6.1.0-18-rt-amd64");
  EXPECT_EQ(kernel_facts(HostFiles(root.path())).is_realtime, false);
}

TEST(Machine, BelowAHypervisorAlsoWithStolenTimeAndQemusBoard) {
  const FakeRoot pi;
  put_pi(pi);
  pi.write("/proc/stat", "cpu 1 2 3 4 5 6 7 8 0 0\ncpu1 1 2 3 4 5 6 7 8 0 0\n");
  EXPECT_EQ(hypervisor_of(HostFiles(pi.path())).present, true);
  EXPECT_EQ(stolen_ticks(HostFiles(pi.path()), 1), 8);
  put_pi(pi);
  pi.write("/proc/device-tree/model", "linux,dummy-virt");
  EXPECT_EQ(hypervisor_of(HostFiles(pi.path())).present, true);
}

}  // namespace
}  // namespace lithe::host
