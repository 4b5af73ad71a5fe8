// SPDX-License-Identifier: Apache-2.0
#include "host/tune/shield/shield_plan.hpp"

#include <gtest/gtest.h>

#include "host/read/tasks.hpp"
#include "host/test/machine_rig.hpp"

namespace lithe::host {
namespace {

constexpr const char* kBoundFlags = "69238880";   // of a worker of the kernel: PF_NO_SETAFFINITY is set
constexpr const char* kMovableFlags = "2129984";  // of kthreadd

void write_task(const FakeRoot& root, int pid, int tid, const std::string& name, const char* flags,
                const std::string& cores) {
  std::string zeros;  // the fields behind the start time
  for (int field = 25; field <= 52; ++field) zeros += " 0";
  const std::string folder = "/proc/" + std::to_string(pid) + "/task/" + std::to_string(tid);
  root.write(folder + "/stat", std::to_string(tid) + " (" + name + ") S 1 0 0 0 -1 " + flags +
                                   " 0 0 0 0 0 0 0 0 20 0 1 0 4711 0 0" + zeros + "\n");
  root.write(folder + "/status", "Name:\tx\nCpus_allowed:\tf\nCpus_allowed_list:\t" + cores + "\n");
}

class ShieldPlanTest : public ::testing::Test {
 protected:
  ShieldPlanTest() {
    write_board(root_);
    write_task(root_, 2, 2, "kthreadd", kMovableFlags, "0-3");
    write_task(root_, 700, 700, "a) b (c", "4194304", "0-3");
    write_task(root_, 700, 701, "a) b (c", "4194304", "1");
    write_task(root_, 800, 800, "bash", "4194304", "0,2-3");
    write_task(root_, 20, 20, "kworker/1:0", kBoundFlags, "1");
    write_task(root_, 21, 21, "kworker/u8:0", kBoundFlags, "0-3");
  }

  void mount_v1() const {
    root_.write("/proc/mounts",
                "tmpfs /sys/fs/cgroup tmpfs rw 0 0\n"
                "cgroup /sys/fs/cgroup/cpuset cgroup rw,relatime,cpuset 0 0\n");
    root_.write("/sys/fs/cgroup/cpuset/cpuset.cpus", "0-3\n");
    root_.write("/sys/fs/cgroup/cpuset/cpuset.sched_load_balance", "1\n");
  }

  HostFiles files() const { return HostFiles(root_.path()); }

  FakeRoot root_;
};

TEST_F(ShieldPlanTest, ATaskIsReadWithAnyName) {
  const auto task = read_task(files(), "/proc/700/task/701");
  ASSERT_TRUE(task);
  EXPECT_EQ(task->pid, 700);
  EXPECT_EQ(task->tid, 701);
  EXPECT_EQ(task->name, "a) b (c");
  EXPECT_EQ(task->start_time_ticks, 4711u);
  EXPECT_EQ(task->cpus, (std::vector<int>{1}));
  EXPECT_FALSE(task->is_bound);
  EXPECT_FALSE(read_task(files(), "/proc/700/task/9"));
}

TEST_F(ShieldPlanTest, EveryTaskIsMovedAndNoOther) {
  const std::vector<Change> moves = moves_plan(files(), {1});
  ASSERT_EQ(moves.size(), 2u);
  EXPECT_EQ(moves[0].path, "/proc/2/task/2") << "kthreadd";
  EXPECT_EQ(moves[1].path, "/proc/700/task/700") << "not 701, which somebody pinned to this core alone";
  EXPECT_EQ(moves[1].before, "0-3");
  EXPECT_EQ(moves[1].after, "0,2-3");
  EXPECT_EQ(moves[1].start_time_ticks, 4711u);
}

TEST_F(ShieldPlanTest, TheRobotsProcessesKeepTheCore) {
  EXPECT_EQ(moves_plan(files(), {1}, {.leave = {700}}).size(), 1u);
  EXPECT_EQ(moves_plan(files(), {1}, {.only = {700}}).size(), 1u);
}

TEST_F(ShieldPlanTest, KernelThreadsThatWereBornSinceAreFound) {
  write_task(root_, 2, 2, "kthreadd", kMovableFlags, "0,2-3");
  write_task(root_, 900, 900, "kcompactd1", kMovableFlags, "0-3");
  const std::vector<Change> moves = moves_plan(files(), {1}, {.kernel = true});
  ASSERT_EQ(moves.size(), 1u) << "bash asked for its cores itself";
  EXPECT_EQ(moves[0].path, "/proc/900/task/900");
}

TEST_F(ShieldPlanTest, AnIsolatedCoreNeedsNothing) {
  mount_v1();
  root_.write("/sys/devices/system/cpu/isolated", "1-3\n");
  const ShieldPlan plan = shield_plan(files(), {1, 3});
  EXPECT_EQ(plan.mechanism, Mechanism::boot);
  EXPECT_TRUE(plan.groups.empty());
  EXPECT_NE(shield_plan(files(), {0, 1}).mechanism, Mechanism::boot) << "core 0 is not isolated";
}

TEST_F(ShieldPlanTest, AnIsolatedPartitionAroundUsNeedsNothing) {
  root_.write("/proc/self/cgroup", "0::/robot\n");
  root_.write("/sys/fs/cgroup/robot/cpuset.cpus.partition", "isolated\n");
  root_.write("/sys/fs/cgroup/robot/cpuset.cpus.effective", "1,3\n");
  EXPECT_EQ(shield_plan(files(), {1, 3}).mechanism, Mechanism::cpuset2);
  root_.write("/sys/fs/cgroup/robot/cpuset.cpus.partition", "isolated invalid (Cpu list not exclusive)\n");
  EXPECT_EQ(shield_plan(files(), {1, 3}).mechanism, Mechanism::affinity);
}

TEST_F(ShieldPlanTest, APartitionOfVersionTwoIsTriedFirst) {
  root_.write("/sys/fs/cgroup/cgroup.controllers", "cpuset cpu io\n");
  root_.write("/sys/fs/cgroup/cgroup.subtree_control", "cpu\n");
  const ShieldPlan plan = shield_plan(files(), {1});
  EXPECT_EQ(plan.mechanism, Mechanism::affinity) << "when the kernel makes none";
  ASSERT_EQ(plan.partition.size(), 5u);
  EXPECT_EQ(plan.partition[0].path, "/sys/fs/cgroup/cgroup.subtree_control");
  EXPECT_EQ(plan.partition[2].after, "1");
  EXPECT_EQ(plan.partition[3].path, "/sys/fs/cgroup/lithe.spine/cpuset.cpus.partition");
  root_.write("/sys/fs/cgroup/cgroup.subtree_control", "cpuset cpu\n");
  EXPECT_EQ(shield_plan(files(), {1}).partition.size(), 4u);
}

TEST_F(ShieldPlanTest, WithoutGroupsAffinityIsLeft) {
  EXPECT_EQ(shield_plan(files(), {1}).mechanism, Mechanism::affinity);
  EXPECT_TRUE(shield_plan(files(), {1}).groups.empty());
}

TEST_F(ShieldPlanTest, VersionOneLeavesTheBalancingLast) {
  mount_v1();
  const ShieldPlan plan = shield_plan(files(), {1});
  EXPECT_EQ(plan.mechanism, Mechanism::cpuset1);
  ASSERT_EQ(plan.groups.size(), 3u);
  EXPECT_EQ(plan.groups[0].kind, ChangeKind::folder);
  EXPECT_EQ(plan.groups[1].after, "0,2-3");
  EXPECT_EQ(plan.groups[2].path, "/sys/fs/cgroup/cpuset/cpuset.sched_load_balance");
  EXPECT_EQ(plan.groups[2].after, "0");
}

TEST_F(ShieldPlanTest, AnotherGroupWithTheCoreKeepsTheBalancing) {
  mount_v1();
  root_.write("/sys/fs/cgroup/cpuset/docker/cpuset.cpus", "0-3\n");
  root_.write("/sys/fs/cgroup/cpuset/docker/cpuset.sched_load_balance", "1\n");
  const ShieldPlan plan = shield_plan(files(), {1});
  EXPECT_EQ(plan.mechanism, Mechanism::affinity);
  ASSERT_EQ(plan.notes.size(), 1u);
  EXPECT_NE(plan.notes[0].find("docker"), std::string::npos);
}

}  // namespace
}  // namespace lithe::host
