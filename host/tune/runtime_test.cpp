// SPDX-License-Identifier: Apache-2.0
#include "host/tune/lasting.hpp"

#include <gtest/gtest.h>

#include <filesystem>

#include "host/test/machine_rig.hpp"

namespace lithe::host {
namespace {

// The value that a plan gives to a path; "-" when it leaves it.
std::string planned(const Plan& plan, const std::string& path) {
  for (const Change& each : plan.changes)
    if (each.path == path) return each.before + " -> " + each.after;
  return "-";
}

class RuntimePlanTest : public ::testing::Test {
 protected:
  RuntimePlanTest() { write_board(root_); }

  Plan plan(const std::vector<int>& cores) const { return runtime_plan(HostFiles(root_.path()), cores); }

  FakeRoot root_;
};

TEST_F(RuntimePlanTest, InterruptsLeaveTheRobotsCores) {
  const Plan plan = this->plan({1, 3});
  EXPECT_EQ(planned(plan, "/proc/irq/24/smp_affinity_list"), "0-3 -> 0,2");
  EXPECT_EQ(planned(plan, "/proc/irq/25/smp_affinity_list"), "1 -> 0,2") << "it has no other core: all others";
  EXPECT_EQ(planned(plan, "/proc/irq/26/smp_affinity_list"), "-") << "it is not there";
  EXPECT_EQ(planned(plan, "/proc/irq/default_smp_affinity"), "f -> 5");
}

TEST_F(RuntimePlanTest, TheKernelsOwnWorkLeavesThem) {
  const Plan plan = this->plan({1});
  EXPECT_EQ(planned(plan, "/sys/devices/virtual/workqueue/cpumask"), "f -> d");
  EXPECT_EQ(planned(plan, "/sys/devices/virtual/workqueue/writeback/cpumask"), "f -> d");
  EXPECT_EQ(planned(plan, "/proc/sys/kernel/watchdog_cpumask"), "0-3 -> 0,2-3");
}

TEST_F(RuntimePlanTest, OnlyWhatDiffersIsPlanned) {
  const Plan plan = this->plan({1});
  EXPECT_EQ(planned(plan, "/proc/sys/kernel/timer_migration"), "1 -> 0");
  EXPECT_EQ(planned(plan, "/proc/sys/kernel/nmi_watchdog"), "-");
  EXPECT_EQ(planned(plan, "/proc/sys/vm/stat_interval"), "1 -> 10");
  EXPECT_EQ(planned(plan, "/sys/kernel/mm/transparent_hugepage/enabled"), "always -> madvise");
  EXPECT_EQ(planned(plan, "/sys/kernel/mm/ksm/run"), "1 -> 0");
  EXPECT_EQ(planned(plan, "/sys/devices/system/cpu/cpufreq/policy0/scaling_governor"), "ondemand -> performance");
}

TEST_F(RuntimePlanTest, ALongerIntervalAndNeverStay) {
  root_.write("/proc/sys/vm/stat_interval", "60\n");
  root_.write("/sys/kernel/mm/transparent_hugepage/enabled", "always madvise [never]\n");
  const Plan plan = this->plan({1});
  EXPECT_EQ(planned(plan, "/proc/sys/vm/stat_interval"), "-");
  EXPECT_EQ(planned(plan, "/sys/kernel/mm/transparent_hugepage/enabled"), "-");
}

TEST_F(RuntimePlanTest, WhatThisKernelDoesNotHaveIsNotPlanned) {
  std::filesystem::remove(root_.path() + "/proc/sys/kernel/timer_migration");
  std::filesystem::remove_all(root_.path() + "/sys/devices/system/cpu/cpufreq");
  const Plan plan = this->plan({1});
  EXPECT_EQ(planned(plan, "/proc/sys/kernel/timer_migration"), "-");
  EXPECT_TRUE(plan.not_done.empty());
}

TEST_F(RuntimePlanTest, WhatCannotBeReadIsToldWithTheReason) {
  std::filesystem::remove(root_.path() + "/proc/sys/kernel/timer_migration");
  std::filesystem::create_directory(root_.path() + "/proc/sys/kernel/timer_migration");
  root_.write("/sys/devices/virtual/workqueue/cpumask", "what?\n");
  const Plan plan = this->plan({1});
  ASSERT_EQ(plan.not_done.size(), 2u);
  EXPECT_EQ(plan.not_done[0].path, "/sys/devices/virtual/workqueue/cpumask");
  EXPECT_EQ(plan.not_done[1].path, "/proc/sys/kernel/timer_migration");
  EXPECT_EQ(plan.not_done[1].why, "Is a directory");
}

TEST_F(RuntimePlanTest, AGovernorThatTheKernelLacksIsNotWritten) {
  root_.write("/sys/devices/system/cpu/cpufreq/policy0/scaling_available_governors", "powersave \n");
  const Plan plan = this->plan({1});
  EXPECT_EQ(planned(plan, "/sys/devices/system/cpu/cpufreq/policy0/scaling_governor"), "-");
  ASSERT_EQ(plan.not_done.size(), 1u);
  EXPECT_NE(plan.not_done[0].why.find("powersave"), std::string::npos);
}

TEST_F(RuntimePlanTest, IrqbalanceIsNamedBecauseItMovesThemBack) {
  root_.write("/proc/612/comm", "irqbalance\n");
  const Plan plan = this->plan({1});
  ASSERT_EQ(plan.notes.size(), 1u);
  EXPECT_NE(plan.notes[0].find("612"), std::string::npos);
}

}  // namespace
}  // namespace lithe::host
