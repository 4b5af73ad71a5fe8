// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/cores.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "spine/core/host/realtime.hpp"
#include "spine/core/host/shield_group.hpp"

namespace lithe {
namespace {

namespace fs = std::filesystem;
using Cpus = std::vector<int>;

// The files of a kernel with other boot options than this one.
class FakeKernel : public ::testing::Test {
 protected:
  ~FakeKernel() override { fs::remove_all(root_); }
  void put(const std::string& path, const std::string& text) const {
    fs::create_directories(fs::path(root_ + path).parent_path());
    std::ofstream(root_ + path) << text << '\n';
  }
  std::string text(const std::string& path) const {
    std::ifstream file(root_ + path);
    std::string word;
    file >> word;
    return word;
  }
  void group(const std::string& path, const std::string& partition, const std::string& cpus) const {
    put("/sys/fs/cgroup" + path + "/cpuset.cpus.partition", partition);
    put("/sys/fs/cgroup" + path + "/cpuset.cpus.effective", cpus);
  }

  std::string root_ = testing::TempDir() + "lithe_kernel_" + std::to_string(getpid());
};

TEST(CpuList, IsReadAsTheKernelWritesIt) {
  EXPECT_EQ(parse_cpu_list("0,2-4,7\n"), (Cpus{0, 2, 3, 4, 7}));
  EXPECT_EQ(parse_cpu_list("3,1-2,2"), (Cpus{1, 2, 3}));
  for (const char* none : {"", "\n", "(null)\n", "1-", "-1", "3-1", "1,,2", "1 2", "0x1", "99999999999", "0-9999"})
    EXPECT_EQ(parse_cpu_list(none), Cpus{}) << none;
  for (const char* same : {"0", "0-1", "1-3,5,8-9", ""}) EXPECT_EQ(cpu_list(parse_cpu_list(same)), same);
}

TEST_F(FakeKernel, ThatSaysNothingIsolatesNothing) {
  const IsolatedCores cores = isolated_cores(0, root_);
  EXPECT_EQ(cores.all(), Cpus{});
  EXPECT_EQ(cores.how(0), Isolation::none);
  EXPECT_FALSE(cores.is_tickless(0));
}

TEST_F(FakeKernel, TellsWhatItWasBootedWith) {
  put("/sys/devices/system/cpu/isolated", "1-3");
  put("/sys/devices/system/cpu/nohz_full", "1");
  const IsolatedCores cores = isolated_cores(0, root_);
  EXPECT_EQ(cores.all(), (Cpus{1, 2, 3}));
  EXPECT_EQ(cores.how(0), Isolation::none);
  EXPECT_EQ(cores.how(3), Isolation::boot);
  EXPECT_TRUE(cores.is_tickless(1));
  EXPECT_FALSE(cores.is_tickless(2));
}

TEST_F(FakeKernel, AnIsolatedPartitionHoldsForTheGroupsInIt) {
  put("/proc/41/cgroup", "3:cpuset:/\n0::/robot/spine");
  put("/proc/42/cgroup", "0::/robot");
  put("/proc/43/cgroup", "0::/");
  group("/robot", "isolated", "2-3");
  group("/robot/spine", "member", "2-3");
  EXPECT_EQ(isolated_cores(41, root_).cpuset, (Cpus{2, 3}));
  EXPECT_EQ(isolated_cores(42, root_).how(2), Isolation::cpuset);
  EXPECT_EQ(isolated_cores(43, root_).all(), Cpus{});
}

// The twins: cores that only seem to be isolated.
TEST_F(FakeKernel, APartitionThatIsInvalidOrBalancedIsNoIsolation) {
  put("/proc/self/cgroup", "0::/robot");
  group("/robot", "isolated invalid (Cpu list in cpuset.cpus not exclusive)", "2-3");
  EXPECT_EQ(isolated_cores(0, root_).all(), Cpus{});
  group("/robot", "root", "2-3");
  EXPECT_EQ(isolated_cores(0, root_).all(), Cpus{});
  group("/robot", "member", "2-3");
  EXPECT_EQ(isolated_cores(0, root_).all(), Cpus{});
  put("/proc/self/cgroup", "0::/../../elsewhere");
  EXPECT_EQ(isolated_cores(0, root_).all(), Cpus{});
}

// What a shield makes (host/tune/shield/shield_plan.hpp): the process is outside, and its threads may join.
TEST_F(FakeKernel, TheCoresOfAShieldAreThereForThreadsThatJoin) {
  put("/sys/fs/cgroup/cgroup.procs", "");
  put("/sys/fs/cgroup/cgroup.threads", "");
  put("/sys/fs/cgroup/lithe.spine/cgroup.threads", "");
  put("/proc/thread-self/cgroup", "0::/user.slice/shell");
  group("/lithe.spine", "isolated", "1,3");
  EXPECT_EQ(shield_cores(root_), (Cpus{1, 3}));
  EXPECT_EQ(isolated_cores(0, root_).how(3), Isolation::cpuset);
  EXPECT_EQ(isolated_cores(1, root_).how(3), Isolation::none) << "of another process nobody knows";
  EXPECT_FALSE(join_group_with(2, root_)) << "it is outside already";
  EXPECT_TRUE(join_group_with(3, root_));
  EXPECT_EQ(text("/sys/fs/cgroup/cgroup.procs"), std::to_string(getpid())) << "first to the root's domain";
  EXPECT_EQ(text("/sys/fs/cgroup/lithe.spine/cgroup.threads"), std::to_string(gettid()));
  put("/proc/thread-self/cgroup", "0::/lithe.spine");
  EXPECT_FALSE(join_group_with(1, root_));
  EXPECT_TRUE(join_group_with(0, root_));
  EXPECT_EQ(text("/sys/fs/cgroup/cgroup.threads"), std::to_string(gettid()));
}

TEST_F(FakeKernel, AShieldThatTheKernelCallsInvalidOrThatIsClosedHasNoCores) {
  put("/sys/fs/cgroup/cgroup.procs", "");
  put("/sys/fs/cgroup/lithe.spine/cgroup.threads", "");
  group("/lithe.spine", "isolated invalid (Parent is not a partition root)", "1");
  EXPECT_EQ(shield_cores(root_), Cpus{});
  group("/lithe.spine", "isolated", "1");
  EXPECT_EQ(shield_cores(root_), Cpus{1});
  put("/sys/fs/cgroup/lithe.spine/cgroup.threads", "4711");
  EXPECT_EQ(shield_cores(root_), Cpus{}) << "another robot's";
  put("/proc/self/task/4711/comm", "ours");
  EXPECT_EQ(shield_cores(root_), Cpus{1});
  fs::remove(root_ + "/sys/fs/cgroup/cgroup.procs");
  EXPECT_EQ(shield_cores(root_), Cpus{});
}

MachineCores booted_with_isolcpus() {
  MachineCores cores;
  cores.online = cores.granted = {0, 1, 2, 3};
  cores.isolated.boot = {1, 2, 3};
  cores.affinity = {0};  // the kernel gives it to init, and init to all processes
  return cores;
}

TEST(MachineCores, IsolatedOnesAreThereForWhoAsks) {
  const MachineCores cores = booted_with_isolcpus();
  EXPECT_EQ(cores.usable(), (Cpus{0, 1, 2, 3}));
  EXPECT_EQ(cores.automatic(), (Cpus{0, 1, 2, 3}));
}

TEST(MachineCores, ThoseOfAnotherCpusetAreNot) {
  MachineCores cores = booted_with_isolcpus();
  cores.granted = {0, 2};
  EXPECT_EQ(cores.usable(), (Cpus{0, 2}));
  EXPECT_EQ(cores.automatic(), (Cpus{0, 2}));
  cores.granted = {};  // the kernel could not be asked
  EXPECT_EQ(cores.usable(), (Cpus{0}));
}

TEST(MachineCores, AnAffinityThatSomebodyHasSetIsKept) {
  MachineCores cores = booted_with_isolcpus();
  cores.affinity = {2, 3};
  EXPECT_EQ(cores.automatic(), (Cpus{2, 3}));
  cores.isolated.boot = {2, 3};  // and of the cores that are not isolated, one: taskset -c 0
  cores.affinity = {0};
  EXPECT_EQ(cores.automatic(), (Cpus{0}));
  EXPECT_EQ(cores.usable(), (Cpus{0, 2, 3})) << "can be set in [spine]";
}

TEST(MachineCores, ThoseOfAShieldComeToAWholeAffinity) {
  MachineCores cores;
  cores.online = cores.granted = {0, 1, 2, 3};
  cores.isolated.cpuset = {1};
  cores.affinity = {0, 2, 3};  // the kernel took the core from every other task
  EXPECT_EQ(cores.automatic(), (Cpus{0, 1, 2, 3}));
  cores.affinity = {2, 3};
  EXPECT_EQ(cores.automatic(), (Cpus{2, 3}));
}

TEST(MachineCores, WithoutIsolationAreTheAffinity) {
  MachineCores cores;
  cores.online = cores.granted = {0, 1, 2, 3};
  cores.affinity = {1, 2};
  EXPECT_EQ(cores.usable(), (Cpus{1, 2}));
  EXPECT_EQ(cores.automatic(), (Cpus{1, 2}));
}

TEST(MachineCores, AskingTheKernelChangesNothing) {
  const Cpus before = allowed_cpus();
  const MachineCores cores = machine_cores();
  EXPECT_EQ(allowed_cpus(), before);
  EXPECT_EQ(cores.affinity, before);
  EXPECT_TRUE(std::includes(cores.granted.begin(), cores.granted.end(), before.begin(), before.end()));
  EXPECT_EQ(granted_cpus({before.front()}), Cpus{before.front()});
  EXPECT_EQ(granted_cpus({1023}), Cpus{}) << "no machine has this core";
}

}  // namespace
}  // namespace lithe
