// SPDX-License-Identifier: Apache-2.0
// Work that is killed before one of its system calls.
#pragma once

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <functional>

namespace lithe::host {

// Runs in a child that dies before its n-th step, which `work` tells by calling what it is given. False: it ended
// before that.
inline bool killed_at(int n, const std::function<void(const std::function<void()>&)>& work) {
  const pid_t child = ::fork();
  if (child == 0) {
    int steps = 0;
    work([&] {
      if (++steps == n) ::kill(::getpid(), SIGKILL);
    });
    ::_exit(0);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_TRUE(WIFSIGNALED(status) || WEXITSTATUS(status) == 0);
  return WIFSIGNALED(status);
}

}  // namespace lithe::host
