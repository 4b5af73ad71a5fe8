// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/child.hpp"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>

namespace lithe {
namespace {

using Clock = std::chrono::steady_clock;

int ms_until(Clock::time_point deadline) {
  const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now()).count();
  return static_cast<int>(std::max<std::int64_t>(left, 0));
}

// Reads until the child closes the pipe or the time is up. False when the time
// is up.
bool drain(int fd, Clock::time_point deadline, std::size_t most, ChildEnd& end) {
  std::array<char, 16384> buffer;
  for (;;) {
    const int left_ms = ms_until(deadline);
    if (left_ms == 0) return false;
    pollfd wait{fd, POLLIN, 0};
    const int ready = poll(&wait, 1, left_ms);
    if (ready < 0 && errno != EINTR) return false;
    if (ready <= 0) continue;
    const ssize_t got = read(fd, buffer.data(), buffer.size());
    if (got <= 0) return true;
    const std::size_t room = most - end.output.size(), size = static_cast<std::size_t>(got);
    end.output.append(buffer.data(), std::min(room, size));
    end.cut = end.cut || size > room;
  }
}

// Waits for the end of the child through its pidfd. False when the time is up.
bool ends_before(pid_t pid, Clock::time_point deadline) {
  const int pidfd = static_cast<int>(syscall(SYS_pidfd_open, pid, 0));
  if (pidfd < 0) return true;
  pollfd wait{pidfd, POLLIN, 0};
  const bool ended = poll(&wait, 1, ms_until(deadline)) != 0;
  close(pidfd);
  return ended;
}

double cpu_ms(const rusage& used) {
  const auto ms = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_usec) / 1e3;
  };
  return ms(used.ru_utime) + ms(used.ru_stime);
}

// Collects the child, or it and all of its group.
void reap(pid_t pid, bool whole_group, ChildEnd& end) {
  rusage used{};
  for (int status = 0;; used = {}) {
    const pid_t got = wait4(whole_group ? -pid : pid, &status, 0, &used);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return;
    end.cpu_ms += cpu_ms(used);
    if (got == pid) {
      end.signal = WIFSIGNALED(status) ? WTERMSIG(status) : 0;
      end.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    }
  }
}

}  // namespace

ChildEnd run_forked(const std::function<int(int)>& body, const ChildLimits& limits) {
  ChildEnd end;
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) {
    end.output = std::string("cannot make a pipe: ") + std::strerror(errno);
    return end;
  }
  if (limits.whole_group) prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0);
  const auto start = Clock::now(), deadline = start + std::chrono::milliseconds(limits.wall_ms);
  const pid_t parent = getpid(), pid = fork();
  if (pid == 0) {
    if (limits.whole_group) setpgid(0, 0);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(1);
    close(ends[0]);
    _exit(body(ends[1]));
  }
  end.started = pid > 0;
  if (!end.started) end.output = std::string("cannot start a process: ") + std::strerror(errno);
  close(ends[1]);
  if (end.started) {
    if (limits.whole_group) setpgid(pid, pid);  // parent and child both call it: either may run first
    end.timed_out = !drain(ends[0], deadline, limits.output_bytes, end);
    if (end.timed_out && limits.last_words) {
      kill(pid, SIGPROF);
      drain(ends[0], Clock::now() + std::chrono::milliseconds(500), limits.output_bytes, end);
    }
    if (!ends_before(pid, deadline)) end.timed_out = true;
    if (limits.whole_group)
      kill(-pid, SIGKILL);
    else if (end.timed_out)
      kill(pid, SIGKILL);
    reap(pid, limits.whole_group, end);
  }
  close(ends[0]);
  end.wall_ms = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  return end;
}

int exec_program(const std::vector<std::string>& argv) {
  std::vector<char*> raw;
  for (const std::string& word : argv) raw.push_back(const_cast<char*>(word.c_str()));
  raw.push_back(nullptr);
  execvp(raw[0], raw.data());
  return errno;
}

}  // namespace lithe
