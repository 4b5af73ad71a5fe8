// SPDX-License-Identifier: Apache-2.0
#include "supervisor/core/process.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

namespace lithe::control {
namespace {

constexpr int kLongMs = 60'000;  // nobody waits for it: what is waited for comes

Launch shell(const std::string& script) {
  Launch launch;
  launch.argv = {"/bin/sh", "-c", script};
  return launch;
}

TEST(Process, TellsAnExitCodeFromASignal) {
  auto three = Process::start(shell("exit 3"));
  ASSERT_TRUE(three && three->wait(kLongMs));
  EXPECT_EQ(three->exit_code(), 3);
  auto killed = Process::start(shell("exec sleep 60"));
  ASSERT_TRUE(killed);
  EXPECT_FALSE(killed->ended());
  killed->signal(SIGKILL);
  ASSERT_TRUE(killed->wait(kLongMs));
  EXPECT_FALSE(killed->exit_code());
  EXPECT_NE(killed->verdict().find("signal 9"), std::string::npos);
}

TEST(Process, WorkIsThatOfTheWholeSession) {
  Launch launch = shell("(while :; do :; done) & wait");
  launch.own_session = true;
  launch.dies_with_parent = true;
  auto busy = Process::start(launch);
  ASSERT_TRUE(busy);
  Work work;
  for (int i = 0; i < kLongMs / 10 && !(work.wants_to_run && work.cpu_s > 0); ++i) {
    ::usleep(10'000);
    work = work_of_session(busy->pid());
  }
  EXPECT_TRUE(work.wants_to_run) << "a child of it";
  EXPECT_GT(work.cpu_s, 0);
  busy->signal(SIGSTOP);
  for (int i = 0; i < kLongMs / 10 && work.wants_to_run; ++i) {
    ::usleep(10'000);
    work = work_of_session(busy->pid());
  }
  EXPECT_FALSE(work.wants_to_run) << "its leader is stopped";
  ::kill(-busy->pid(), SIGKILL);
  EXPECT_TRUE(busy->wait(kLongMs));
}

// Whether a program finds what it was handed as descriptor 3. Runs in a process of its own: it takes that number.
bool hands_over(bool has_the_number_already) {
  const pid_t pid = ::fork();
  if (pid == 0) {
    int pair[2];
    if (::pipe2(pair, O_CLOEXEC) != 0) ::_exit(1);
    const int from = ::fcntl(pair[0], F_DUPFD_CLOEXEC, 20);
    const int to = ::fcntl(pair[1], F_DUPFD_CLOEXEC, 20);
    Launch launch = shell("echo handed >&3");
    launch.extra_fd = has_the_number_already ? ::dup3(to, 3, O_CLOEXEC) : to;
    if (!has_the_number_already) ::close(3);  // the next descriptor that Process opens for itself gets the number
    auto child = Process::start(launch);
    char text[8] = "";
    const bool handed = child && child->wait(kLongMs) && ::read(from, text, 7) == 7;
    ::_exit(handed && std::string(text) == "handed\n" ? 0 : 1);
  }
  int status = 1;
  ::waitpid(pid, &status, 0);
  return status == 0;
}

TEST(Process, HandsOverADescriptorAsNumberThree) {
  EXPECT_TRUE(hands_over(false));
  EXPECT_TRUE(hands_over(true));
}

TEST(Process, AMissingProgramIsAnErrorAndLeavesNoChild) {
  Launch launch;
  launch.argv = {"/nowhere/lithe-spine"};
  const auto process = Process::start(launch);
  ASSERT_FALSE(process);
  EXPECT_NE(process.message().find("No such file"), std::string::npos);
  EXPECT_EQ(::waitpid(-1, nullptr, WNOHANG), -1);
}

TEST(Process, SignalsThatTheParentBlocksReachTheChild) {
  sigset_t set, before;
  sigemptyset(&set);
  sigaddset(&set, SIGTERM);
  ::sigprocmask(SIG_BLOCK, &set, &before);
  auto process = Process::start(shell("exec sleep 60"));
  ::sigprocmask(SIG_SETMASK, &before, nullptr);
  ASSERT_TRUE(process);
  process->signal(SIGTERM);
  EXPECT_TRUE(process->wait(kLongMs));
}

TEST(Process, AnIdleChildYieldsToEverybody) {
  Launch launch = shell("exec sleep 60");
  launch.idle_priority = true;
  auto process = Process::start(launch);
  ASSERT_TRUE(process);
  EXPECT_EQ(::sched_getscheduler(process->pid()), SCHED_IDLE);
  process->signal(SIGKILL);
  process->wait(kLongMs);
}

TEST(Cores, KeepOffTheSpineAndTheTransportWhereThereIsRoom) {
  EXPECT_EQ(cores_beside({0, 1, 2, 3}, 1, 3), (std::vector<int>{0, 2}));
  EXPECT_EQ(cores_beside({0, 1}, 1, -1), (std::vector<int>{0}));
  EXPECT_EQ(cores_beside({0, 1}, 1, 0), (std::vector<int>{0}));
  EXPECT_EQ(cores_beside({5}, 5, 5), (std::vector<int>{5}));
}

}  // namespace
}  // namespace lithe::control
