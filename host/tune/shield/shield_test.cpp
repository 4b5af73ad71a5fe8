// SPDX-License-Identifier: Apache-2.0
// The shield with real tasks: a child of this test and its threads, and no other task of the machine.
#include "host/tune/shield/shield.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <set>
#include <thread>

#include "host/read/tasks.hpp"
#include "host/test/killed_rig.hpp"
#include "host/test/root_rig.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/realtime.hpp"

namespace lithe::host {
namespace {

// A process with one thread more for every call of bear().
class Parent {
 public:
  explicit Parent(const char* name = "parent") {
    int down[2], up[2];
    EXPECT_EQ(::pipe(down), 0);
    EXPECT_EQ(::pipe(up), 0);
    pid_ = ::fork();
    if (pid_ == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      ::prctl(PR_SET_NAME, name);  // its threads inherit it
      for (char word = 0; ::read(down[0], &word, 1) == 1;) {
        std::thread([] { std::this_thread::sleep_for(std::chrono::hours(1)); }).detach();
        (void)!::write(up[1], &word, 1);
      }
      ::_exit(0);
    }
    order_ = Fd(down[1]);
    answer_ = Fd(up[0]);
    ::close(down[0]);
    ::close(up[1]);
    bear();
  }
  Parent(const Parent&) = delete;
  Parent& operator=(const Parent&) = delete;
  ~Parent() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }

  int pid() const { return pid_; }

  void bear() {
    char word = 'x';
    EXPECT_EQ(::write(order_.get(), &word, 1), 1);
    EXPECT_EQ(::read(answer_.get(), &word, 1), 1);
  }

  // Two, or more where an emulator has one of its own in each process.
  std::size_t tasks() const { return read_tasks(HostFiles(), {pid_}).all.size(); }

  // The masks of its threads, without repetition.
  std::set<std::vector<int>> masks() const {
    std::set<std::vector<int>> masks;
    for (const Task& task : read_tasks(HostFiles(), {pid_}).all) masks.insert(task.cpus);
    return masks;
  }

 private:
  pid_t pid_ = 0;
  Fd order_, answer_;
};

class ShieldTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (all_.size() < 2) GTEST_SKIP() << "one core: nothing can be kept free";
    parent_ = std::make_unique<Parent>();
    options_ = {.cores = {all_.back()},
                .only = {parent_->pid()},
                .machine = false,
                .journal = folder_.path() + "/shield.journal"};
    rest_.assign(all_.begin(), all_.end() - 1);
  }

  std::vector<int> all_ = allowed_cpus(), rest_;
  FakeRoot folder_;
  std::unique_ptr<Parent> parent_;
  ShieldOptions options_;
};

using Masks = std::set<std::vector<int>>;

TEST_F(ShieldTest, TasksLeaveTheCoreAndComeBack) {
  {
    const auto shield = Shield::raise(options_);
    ASSERT_TRUE(shield) << shield.message();
    EXPECT_EQ(shield->facts().moved, parent_->tasks());
    EXPECT_EQ(shield->facts().mechanism, Mechanism::affinity);
    EXPECT_EQ(parent_->masks(), Masks{rest_});
  }
  EXPECT_EQ(parent_->masks(), Masks{all_});
  EXPECT_FALSE(std::filesystem::exists(options_.journal));
}

TEST_F(ShieldTest, AThreadBornUnderItInheritsAndGetsTheCoreAtItsEnd) {
  auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  parent_->bear();
  EXPECT_EQ(parent_->masks(), Masks{rest_});
  const auto lowered = shield->lower();
  ASSERT_TRUE(lowered);
  EXPECT_EQ(parent_->masks(), Masks{all_});
  ASSERT_EQ(lowered->born.size(), 1u) << "it may have chosen just these cores: it is named";
  EXPECT_NE(born_words(*lowered).find("parent "), std::string::npos) << born_words(*lowered);
}

TEST_F(ShieldTest, LithesOwnProgramsChooseTheirCoresAndKeepThem) {
  parent_ = std::make_unique<Parent>("lawd");
  options_.only = {parent_->pid()};
  auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield) << shield.message();
  parent_->bear();  // as of another robot, started under this shield
  EXPECT_TRUE(shield->lower());
  EXPECT_EQ(parent_->masks(), (Masks{rest_, all_}));
}

TEST_F(ShieldTest, ATaskThatSomebodyElseMovedStaysThere) {
  auto shield = Shield::raise(options_);
  ASSERT_TRUE(shield);
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(static_cast<unsigned>(all_.back()), &set);
  ASSERT_EQ(::sched_setaffinity(parent_->pid(), sizeof set, &set), 0);
  EXPECT_TRUE(shield->lower());
  EXPECT_EQ(parent_->masks(), (Masks{{all_.back()}, all_}));
}

TEST_F(ShieldTest, ASecondOneIsRefusedWhileTheFirstIsUp) {
  const auto first = Shield::raise(options_);
  ASSERT_TRUE(first);
  EXPECT_FALSE(Shield::raise(options_));
  EXPECT_FALSE(Shield::lower_left_over(options_));
  EXPECT_EQ(parent_->masks(), Masks{rest_}) << "the refused one must not undo it";
}

TEST_F(ShieldTest, WhateverAKilledHolderLeftIsGivenBack) {
  int kills = 0;
  for (bool killed = true; killed; kills += killed ? 1 : 0) {
    killed = killed_at(kills + 1, [&](const StepHook& step) {
      options_.hook = step;
      const auto shield = Shield::raise(options_);
    });
    const auto lowered = Shield::lower_left_over(options_);
    ASSERT_TRUE(lowered && lowered->failed.empty()) << "killed before system call " << kills + 1;
    ASSERT_EQ(parent_->masks(), Masks{all_}) << "killed before system call " << kills + 1;
  }
  std::printf("%d kills of a shield\n", kills);
  EXPECT_GT(kills, 8);
}

TEST_F(ShieldTest, TheNextOneFindsWhatAKilledHolderLeft) {
  const pid_t holder = ::fork();
  if (holder == 0) {
    const auto shield = Shield::raise(options_);
    ::kill(::getpid(), SIGKILL);
  }
  ::waitpid(holder, nullptr, 0);
  EXPECT_EQ(parent_->masks(), Masks{rest_});
  {
    const auto next = Shield::raise(options_);
    ASSERT_TRUE(next) << next.message();
    EXPECT_EQ(next->facts().moved, parent_->tasks()) << "they were given back first";
  }
  EXPECT_EQ(parent_->masks(), Masks{all_});
}

}  // namespace
}  // namespace lithe::host
