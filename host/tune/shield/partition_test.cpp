// SPDX-License-Identifier: Apache-2.0
// The groups of cgroup v2 and v1 on a machine made of files, with a real child as the only task. A real kernel:
// docs/host.md.
#include "host/tune/shield/shield_plan.hpp"

#include <gtest/gtest.h>
#include <sched.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <functional>
#include <map>
#include <memory>

#include "host/read/tasks.hpp"
#include "host/test/groups_rig.hpp"
#include "host/test/killed_rig.hpp"
#include "host/test/machine_rig.hpp"
#include "host/tune/shield/shield.hpp"
#include "host/tune/tune.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/realtime.hpp"

namespace lithe::host {
namespace {

using Content = std::map<std::string, std::string>;

// A process that sleeps.
class Sleeper {
 public:
  Sleeper() : pid_(::fork()) {
    if (pid_ != 0) return;
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    for (;;) ::pause();
  }
  Sleeper(const Sleeper&) = delete;
  Sleeper& operator=(const Sleeper&) = delete;
  ~Sleeper() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  int pid() const { return pid_; }
  void choose(const std::vector<int>& cores) const {
    cpu_set_t set;
    CPU_ZERO(&set);
    for (const int core : cores) CPU_SET(static_cast<unsigned>(core), &set);
    EXPECT_EQ(::sched_setaffinity(pid_, sizeof set, &set), 0);
  }

 private:
  pid_t pid_;
};

class PartitionTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (all_.size() < 2) GTEST_SKIP() << "one core: nothing can be kept free";
    write_board(root_);
    root_.write("/sys/devices/system/cpu/online", cpu_list(all_) + "\n");
    root_.write("/sys/kernel/mm/transparent_hugepage/enabled", "madvise\n");  // its brackets are the kernel's own
    use(FakeGroups::Kernel::isolates);
  }

  void use(FakeGroups::Kernel kernel) {
    groups_ = std::make_unique<FakeGroups>(root_, kernel);
    options_ = {.cores = {all_.back()},
                .only = {task_.pid()},
                .root = root_.path(),
                .journal = folder_.path() + "/shield.journal",
                .hook = [this] { hook_(); }};
    hook_ = [this] { groups_->settle(); };
  }
  std::string text(const std::string& path) const { return HostFiles(root_.path()).read(path).value; }
  bool has_group() const { return std::filesystem::exists(root_.path() + kShieldGroup); }

  std::vector<int> all_ = allowed_cpus();
  FakeRoot root_, folder_;
  Sleeper task_;
  std::unique_ptr<FakeGroups> groups_;
  std::function<void()> hook_;
  ShieldOptions options_;
};

constexpr const char* kControl = "/sys/fs/cgroup/cgroup.subtree_control";

TEST_F(PartitionTest, AShieldMakesItAndTakesItDown) {
  const Content before = content_of(root_);
  {
    const auto shield = Shield::raise(options_);
    ASSERT_TRUE(shield) << shield.message();
    EXPECT_EQ(shield->facts().mechanism, Mechanism::cpuset2);
    EXPECT_TRUE(shield->has_partition());
    EXPECT_EQ(text(std::string(kShieldGroup) + "/cpuset.cpus.partition"), "isolated");
    EXPECT_EQ(text(std::string(kShieldGroup) + "/cgroup.type"), "threaded");
    EXPECT_EQ(text(kControl), "cpuset cpu memory");
    EXPECT_TRUE(partition_plan(HostFiles(root_.path()), options_.cores).empty()) << "it is in force";
  }
  groups_->settle();
  EXPECT_FALSE(has_group());
  EXPECT_EQ(content_of(root_), before);
}

TEST_F(PartitionTest, OneThatTheKernelCallsInvalidIsUndoneAndTheNextMechanismTaken) {
  use(FakeGroups::Kernel::says_invalid);
  const auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  EXPECT_EQ(shield->facts().mechanism, Mechanism::affinity);
  EXPECT_FALSE(has_group());
  ASSERT_FALSE(shield->facts().notes.empty());
  EXPECT_NE(shield->facts().notes.front().find("isolated invalid (Cpu list in cpuset.cpus not exclusive)"),
            std::string::npos)
      << shield->facts().notes.front();
  EXPECT_EQ(shield->facts().moved, read_tasks(HostFiles(), {task_.pid()}).all.size()) << "the task was moved instead";
}

TEST_F(PartitionTest, AKernelWithoutPartitionsGivesTheNextMechanism) {
  use(FakeGroups::Kernel::refuses);
  const auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  EXPECT_EQ(shield->facts().mechanism, Mechanism::affinity);
  EXPECT_FALSE(has_group());
}

TEST_F(PartitionTest, OneThatTheKernelEndsIsToldAndTheTasksAreMoved) {
  auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  EXPECT_EQ(shield->keep_up()->size(), 0u);
  root_.write(std::string(kShieldGroup) + "/cpuset.cpus.partition",
              "isolated invalid (Parent is not a partition root)\n");
  task_.choose(all_);  // kernels before 6.2 forget what a task had
  const auto told = shield->keep_up();
  ASSERT_TRUE(told);
  EXPECT_NE(told->find("Parent is not a partition root"), std::string::npos) << *told;
  EXPECT_EQ(shield->facts().mechanism, Mechanism::affinity);
  EXPECT_EQ(read_tasks(HostFiles(), {task_.pid()}).all[0].cpus, cores_without(all_, options_.cores));
}

// Its own core would be an ordinary one, though the partition that is there says "isolated".
TEST_F(PartitionTest, OneOfOtherCoresIsNotTakenForTheShields) {
  const Target target{.root = root_.path(), .all_cores = all_, .cores = {all_.front()}, .partition = true};
  ASSERT_TRUE(tune_apply(target, tune_plan(target).changes, [&] { groups_->settle(); }));
  ASSERT_EQ(partition_state(HostFiles(root_.path())), "isolated");
  const auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  EXPECT_EQ(shield->facts().mechanism, Mechanism::affinity);
  EXPECT_FALSE(shield->has_partition());
  EXPECT_NE(shield->facts().notes.at(0).find("there is one for cores " + cpu_list(target.cores)), std::string::npos)
      << shield->facts().notes.at(0);
  Target other = target;
  other.cores = options_.cores;
  const auto again = tune_apply(other, tune_plan(other).changes, [&] { groups_->settle(); });
  ASSERT_TRUE(again);
  EXPECT_FALSE(again->well());
  EXPECT_EQ(partition_state(HostFiles(root_.path())), "isolated") << "a robot may have its threads there";
  EXPECT_EQ(text(std::string(kShieldGroup) + "/cpuset.cpus"), cpu_list(target.cores));
}

// Without the controller at the root its cores would be lost without a word.
TEST_F(PartitionTest, CoresThatAnotherGroupChoseMeanwhileStay) {
  {
    const auto shield = Shield::raise(options_);
    ASSERT_TRUE(shield) << shield.message();
    root_.write("/sys/fs/cgroup/system.slice/cpuset.cpus", "0\n");
  }
  groups_->settle();
  EXPECT_FALSE(has_group());
  EXPECT_EQ(text(kControl), "cpuset cpu memory");
}

TEST_F(PartitionTest, TasksBornAfterTheKernelEndedItGetTheirCoresBack) {
  const pid_t holder = ::fork();
  if (holder == 0) {
    auto shield = Shield::raise(options_);
    root_.write(std::string(kShieldGroup) + "/cpuset.cpus.partition", "isolated invalid (no reason)\n");
    (void)shield->keep_up();
    ::kill(::getpid(), SIGKILL);
  }
  ::waitpid(holder, nullptr, 0);
  const Sleeper born;
  born.choose(cores_without(all_, options_.cores));  // as it inherits them
  ShieldOptions again = options_;
  again.only.push_back(born.pid());
  again.hook = [&] { groups_->settle(true); };
  const auto lowered = Shield::lower_left_over(again);
  ASSERT_TRUE(lowered) << lowered.message();
  EXPECT_EQ(read_tasks(HostFiles(), {born.pid()}).all[0].cpus, all_);
  EXPECT_EQ(lowered->born.size(), read_tasks(HostFiles(), {born.pid()}).all.size()) << "and it is named";
}

TEST_F(PartitionTest, OneThatWasThereBeforeIsWatchedToo) {
  const Target target{.root = root_.path(), .all_cores = all_, .cores = options_.cores, .partition = true};
  ASSERT_TRUE(tune_apply(target, tune_plan(target).changes, [&] { groups_->settle(); }));
  auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  EXPECT_FALSE(shield->has_partition());
  ASSERT_EQ(shield->facts().mechanism, Mechanism::cpuset2);
  EXPECT_EQ(shield->keep_up()->size(), 0u);
  EXPECT_EQ(shield->facts().moved, 0u);
  root_.write(std::string(kShieldGroup) + "/cpuset.cpus.partition", "isolated invalid (no reason)\n");
  const auto told = shield->keep_up();
  ASSERT_TRUE(told);
  EXPECT_NE(told->find("the kernel ended the partition"), std::string::npos) << *told;
  EXPECT_EQ(shield->facts().mechanism, Mechanism::affinity);
  EXPECT_EQ(read_tasks(HostFiles(), {task_.pid()}).all[0].cpus, cores_without(all_, options_.cores));
}

// Kernels before 6.2 give every task all cores when a partition ends.
TEST_F(PartitionTest, ATasksOwnChoiceIsGivenBackByOldKernelsToo) {
  for (const bool later : {false, true}) {
    use(FakeGroups::Kernel::isolates);
    root_.write("/proc/sys/kernel/osrelease", "6.1.0\n");
    task_.choose(later ? all_ : std::vector<int>{all_.back()});
    auto shield = Shield::raise(options_);
    ASSERT_TRUE(shield) << shield.message();
    task_.choose(later ? options_.cores : cores_without(all_, options_.cores));  // somebody, or the kernel
    bool ended = false;
    // The kernel, as soon as the partition has ended.
    hook_ = [&] {
      groups_->settle();
      if (!ended && text(std::string(kShieldGroup) + "/cpuset.cpus.partition") == "member") {
        ended = true;
        task_.choose(all_);
      }
    };
    ASSERT_TRUE(shield->lower());
    EXPECT_EQ(read_tasks(HostFiles(), {task_.pid()}).all[0].cpus, std::vector<int>{all_.back()})
        << (later ? "chosen under the partition" : "chosen before it");
  }
}

TEST_F(PartitionTest, AShieldKilledBeforeAnySystemCallLeavesNoGroup) {
  const Content before = content_of(root_);
  int kills = 0;
  for (bool killed = true; killed; kills += killed ? 1 : 0) {
    killed = killed_at(kills + 1, [&](const StepHook& step) {
      options_.hook = [&] {
        groups_->settle();
        step();
      };
      const auto shield = Shield::raise(options_);
    });
    ShieldOptions again = options_;
    again.hook = [&] { groups_->settle(true); };
    const auto lowered = Shield::lower_left_over(again);
    ASSERT_TRUE(lowered && lowered->failed.empty()) << "killed before system call " << kills + 1;
    groups_->settle(true);
    ASSERT_EQ(content_of(root_), before) << "killed before system call " << kills + 1;
  }
  std::printf("%d kills of a shield with a partition\n", kills);
  EXPECT_GT(kills, 30);
}

TEST_F(PartitionTest, TuneMakesItOnRequestAndTakesItBack) {
  Target target{.root = root_.path(), .all_cores = all_, .cores = {all_.back()}, .partition = true};
  const Content before = content_of(root_);
  const auto raising = [&] { groups_->settle(); };
  const auto made = tune_apply(target, tune_plan(target).changes, raising);
  ASSERT_TRUE(made && made->well()) << made.message();
  EXPECT_EQ(partition_state(HostFiles(root_.path())), "isolated");
  EXPECT_TRUE(tune_plan(target).changes.empty()) << "a second apply";
  const auto undone = tune_revert(target, false, [&] { groups_->settle(true); });
  ASSERT_TRUE(undone && undone->well()) << undone.message();
  groups_->settle(true);
  EXPECT_EQ(content_of(root_), before);
}

TEST_F(PartitionTest, TuneSaysWhyThereIsNone) {
  use(FakeGroups::Kernel::says_invalid);
  const Target target{.root = root_.path(), .all_cores = all_, .cores = {all_.back()}, .partition = true};
  const auto made = tune_apply(target, tune_plan(target).changes, [&] { groups_->settle(); });
  ASSERT_TRUE(made);
  EXPECT_FALSE(made->well());
  EXPECT_FALSE(has_group());
  EXPECT_NE(made->notes.at(0).find("isolated invalid (Cpu list"), std::string::npos) << made->notes.at(0);
}

// cgroup v1, on a hybrid machine as systemd makes it: the cpusets are there, v2 has none.
class VersionOneTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (all_.size() < 2) GTEST_SKIP() << "one core: nothing can be kept free";
    write_board(root_);
    root_.write("/sys/devices/system/cpu/online", cpu_list(all_) + "\n");
    root_.write("/sys/kernel/mm/transparent_hugepage/enabled", "madvise\n");
    root_.write("/proc/mounts",
                "cgroup /sys/fs/cgroup/cpuset cgroup rw,cpuset 0 0\n"
                "cgroup2 /sys/fs/cgroup/unified cgroup2 rw 0 0\n");
    root_.write("/sys/fs/cgroup/unified/cgroup.controllers", "\n");
    root_.write("/sys/fs/cgroup/cpuset/cpuset.cpus", cpu_list(all_) + "\n");
    root_.write(kBalance, "1\n");
    options_ = {.cores = {all_.back()},
                .only = {task_.pid()},
                .root = root_.path(),
                .journal = folder_.path() + "/shield.journal",
                .hook = [this] { settle(); }};
    before_ = content_of(root_);
  }

  // What the kernel does between two system calls: a new group has its files, and rmdir(2) does not mind them.
  void settle(bool lowering = false) {
    const std::string file = root_.path() + kRestCores;
    if (!std::filesystem::exists(file)) {
      const bool made = std::filesystem::is_directory(std::filesystem::path(file).parent_path());
      if (made && makes_files_ && !lowering && !used_) root_.write(kRestCores, "\n");
      if (!made) used_ = false;
      return;
    }
    used_ = used_ || !text(kRestCores).empty();
    if (text(kBalance) == "0" && cores_of_task() == all_) early_ = true;
    if ((used_ || lowering) && text(kRestCores).empty()) std::filesystem::remove(file);
  }

  std::string text(const std::string& path) const { return HostFiles(root_.path()).read(path).value; }
  std::vector<int> cores_of_task() const { return read_tasks(HostFiles(), {task_.pid()}).all[0].cpus; }

  static constexpr const char* kBalance = "/sys/fs/cgroup/cpuset/cpuset.sched_load_balance";
  static constexpr const char* kRestCores = "/sys/fs/cgroup/cpuset/lithe.rest/cpuset.cpus";
  std::vector<int> all_ = allowed_cpus();
  FakeRoot root_, folder_;
  Sleeper task_;
  Content before_;
  ShieldOptions options_;
  bool makes_files_ = true, used_ = false, early_ = false;
};

TEST_F(VersionOneTest, AShieldMovesTheTasksAndThenEndsTheBalancing) {
  {
    const auto shield = Shield::raise(options_);
    ASSERT_TRUE(shield) << shield.message();
    EXPECT_EQ(shield->facts().mechanism, Mechanism::cpuset1);
    EXPECT_EQ(text(kRestCores), cpu_list(cores_without(all_, options_.cores)));
    EXPECT_EQ(text(kBalance), "0");
    EXPECT_EQ(cores_of_task(), cores_without(all_, options_.cores));
    EXPECT_EQ(content_of(root_).count("/sys/fs/cgroup/lithe.spine/cpuset.cpus"), 0u) << "no group of v2";
  }
  EXPECT_EQ(content_of(root_), before_);
  EXPECT_EQ(cores_of_task(), all_);
  EXPECT_FALSE(early_) << "a task that is on the core when the balancing ends stays there for good";
}

TEST_F(VersionOneTest, AKernelThatMakesNoGroupLeavesAffinity) {
  makes_files_ = false;
  const auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  EXPECT_EQ(shield->facts().mechanism, Mechanism::affinity);
  EXPECT_EQ(text(kBalance), "1");
  EXPECT_FALSE(std::filesystem::exists(root_.path() + "/sys/fs/cgroup/cpuset/lithe.rest"));
  EXPECT_EQ(cores_of_task(), cores_without(all_, options_.cores));
}

TEST_F(VersionOneTest, AShieldKilledBeforeAnySystemCallIsUndone) {
  int kills = 0;
  for (bool killed = true; killed; kills += killed ? 1 : 0) {
    killed = killed_at(kills + 1, [&](const StepHook& step) {
      options_.hook = [&] {
        settle();
        step();
      };
      const auto shield = Shield::raise(options_);
    });
    ShieldOptions again = options_;
    again.hook = [&] { settle(true); };
    const auto lowered = Shield::lower_left_over(again);
    ASSERT_TRUE(lowered && lowered->failed.empty()) << "killed before system call " << kills + 1;
    ASSERT_EQ(content_of(root_), before_) << "killed before system call " << kills + 1;
    ASSERT_EQ(cores_of_task(), all_) << "killed before system call " << kills + 1;
  }
  std::printf("%d kills of a shield with cgroup v1\n", kills);
  EXPECT_GT(kills, 20);
}

}  // namespace
}  // namespace lithe::host
