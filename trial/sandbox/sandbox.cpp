// SPDX-License-Identifier: Apache-2.0
#include "trial/sandbox/sandbox.hpp"

#include <fcntl.h>
#include <malloc.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <thread>

namespace lithe::trial {
namespace {

using Clock = std::chrono::steady_clock;

double ms_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

Error system_error(const char* what) { return Error{std::string(what) + ": " + std::strerror(errno)}; }

// The address space in use now [bytes].
std::size_t mapped_bytes() {
  std::array<char, 64> text{};
  const int fd = open("/proc/self/statm", O_RDONLY | O_CLOEXEC);
  const ssize_t got = fd < 0 ? -1 : read(fd, text.data(), text.size() - 1);
  if (fd >= 0) close(fd);
  const std::size_t pages = got > 0 ? std::strtoul(text.data(), nullptr, 10) : 0;
  return pages * static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
}

bool limit(__rlimit_resource resource, rlim_t soft, rlim_t hard) {
  const rlimit value{soft, hard};
  return setrlimit(resource, &value) == 0;
}

// Reads the child's output until it ends or the time is over. False when the time is over.
bool drain(int fd, Clock::time_point deadline, std::size_t expected, std::string& output) {
  std::array<char, 4096> buffer;
  for (;;) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now()).count();
    if (left <= 0) return false;
    pollfd wait{fd, POLLIN, 0};
    const int ready = poll(&wait, 1, static_cast<int>(left));
    if (ready < 0 && errno != EINTR) return false;
    if (ready <= 0) continue;
    const ssize_t got = read(fd, buffer.data(), buffer.size());
    if (got <= 0) return true;
    const std::size_t room = expected - std::min(expected, output.size());
    output.append(buffer.data(), std::min(room, static_cast<std::size_t>(got)));
  }
}

// Waits for the end of a child through its pidfd, without polling.
void reap(pid_t pid, Clock::time_point deadline, Outcome& outcome) {
  const int pidfd = static_cast<int>(syscall(SYS_pidfd_open, pid, 0));
  if (pidfd >= 0) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now()).count();
    pollfd wait{pidfd, POLLIN, 0};
    if (poll(&wait, 1, static_cast<int>(std::max<std::int64_t>(left, 0))) == 0) outcome.timed_out = true;
    close(pidfd);
  }
  if (outcome.timed_out) kill(pid, SIGKILL);
  int status = 0;
  rusage used{};
  while (wait4(pid, &status, 0, &used) < 0 && errno == EINTR) {
  }
  outcome.signal = WIFSIGNALED(status) ? WTERMSIG(status) : 0;
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  const auto ms = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_usec) / 1e3;
  };
  outcome.cpu_ms = ms(used.ru_utime) + ms(used.ru_stime);
}

}  // namespace

Outcome run_sandboxed(const std::function<int(int)>& body, const Limits& limits, std::size_t expected) {
  Outcome outcome;
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return outcome;
  const auto start = Clock::now();
  const pid_t parent = getpid(), pid = fork();
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(1);
    _exit(body(ends[1]));
  }
  close(ends[1]);
  outcome.started = pid > 0;
  if (outcome.started) {
    const auto deadline = start + std::chrono::milliseconds(limits.wall_ms);
    outcome.timed_out = !drain(ends[0], deadline, expected, outcome.output);
    if (outcome.timed_out) {  // it may still report where it is
      kill(pid, SIGPROF);
      drain(ends[0], Clock::now() + std::chrono::milliseconds(50), expected, outcome.output);
    }
    reap(pid, deadline, outcome);
  }
  close(ends[0]);
  outcome.wall_ms = ms_since(start);
  return outcome;
}

bool keep_heap(std::size_t bytes) {
  if (mallopt(M_MMAP_MAX, 0) != 1 || mallopt(M_TRIM_THRESHOLD, -1) != 1) return false;
  void* volatile memory = std::malloc(bytes);  // volatile: a compiler may leave out a pair that does nothing
  std::free(memory);
  return memory != nullptr;
}

Result<> shed_rights(int pipe_fd, const Limits& limits) {
  const int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
  for (int fd = 0; fd < 3; ++fd) {
    if (null < 0 || dup2(null, fd) < 0) return system_error("cannot close the standard streams");
  }
  // Number 3 is the pipe now, and nothing else is open.
  if (pipe_fd != 3 && dup2(pipe_fd, 3) < 0) return system_error("cannot move the pipe");
  if (syscall(SYS_close_range, 4u, ~0u, 0u) != 0) return system_error("cannot close what was inherited");
  const auto cpu_s = static_cast<rlim_t>(limits.cpu_ms) / 1000 + 1;
  bool ok = limit(RLIMIT_CORE, 0, 0) && limit(RLIMIT_CPU, cpu_s, cpu_s + 1) && limit(RLIMIT_NPROC, 0, 0) &&
            limit(RLIMIT_FSIZE, 16u << 20, 16u << 20) && limit(RLIMIT_STACK, 1u << 20, 1u << 20) &&
            limit(RLIMIT_MEMLOCK, 0, 0) && limit(RLIMIT_NOFILE, 64, 64);
  const rlim_t memory = mapped_bytes() + limits.memory_bytes;
  ok = ok && (kSanitized || limit(RLIMIT_AS, memory, memory));
  if (!ok) return system_error("cannot set the limits of the trial");
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return system_error("cannot give up new privileges");
  prctl(PR_SET_DUMPABLE, 0);
  const itimerval box{{0, 0}, {limits.cpu_ms / 1000, limits.cpu_ms % 1000 * 1000}};
  if (setitimer(ITIMER_PROF, &box, nullptr) != 0) return system_error("cannot set the time box");
  return done();
}

}  // namespace lithe::trial
