// SPDX-License-Identifier: Apache-2.0
#include "lawd/run/child.hpp"

#include <cxxabi.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>

namespace lithe::lawd {
namespace {

using Clock = std::chrono::steady_clock;
constexpr std::size_t kMaxOutput = std::size_t{4} << 20;

void limit(__rlimit_resource resource, std::size_t amount) {
  const rlimit value{amount, amount};
  setrlimit(resource, &value);
}

[[noreturn]] void child_main(const std::function<int(int)>& body, int out_fd, const Limits& limits) {
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  for (const int signal : {SIGPIPE, SIGINT, SIGTERM, SIGSEGV, SIGFPE, SIGILL, SIGBUS, SIGABRT}) {
    ::signal(signal, SIG_DFL);
  }
  const int null = open("/dev/null", O_RDWR);
  for (const int fd : {0, 1, 2}) dup2(null, fd);
  limit(RLIMIT_CORE, 0);
  const auto cpu_s = static_cast<rlim_t>(limits.cpu_s);
  const rlimit cpu{cpu_s, cpu_s + 1};  // SIGXCPU comes first: it tells an endless loop from a lack of memory
  setrlimit(RLIMIT_CPU, &cpu);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)  // their shadow memory needs the address space
  limit(RLIMIT_AS, limits.memory_bytes);
#endif
  limit(RLIMIT_FSIZE, limits.file_bytes);
  _exit(body(out_fd));
}

// Reads until the child closes the pipe or the time is up. False when the time is up.
bool drain(int fd, Clock::time_point deadline, Outcome& outcome) {
  std::array<char, 16384> buffer;
  for (;;) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now()).count();
    if (left <= 0) return false;
    pollfd wait{fd, POLLIN, 0};
    if (poll(&wait, 1, static_cast<int>(left)) < 0 && errno != EINTR) return false;
    if (wait.revents == 0) continue;
    const ssize_t got = read(fd, buffer.data(), buffer.size());
    if (got <= 0) return true;
    const std::size_t room = kMaxOutput - outcome.output.size(), size = static_cast<std::size_t>(got);
    outcome.output.append(buffer.data(), std::min(room, size));
    outcome.cut = outcome.cut || size > room;
  }
}

double cpu_ms(const rusage& used) {
  const auto ms = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_usec) / 1e3;
  };
  return ms(used.ru_utime) + ms(used.ru_stime);
}

// Waits for the end of the child, until the deadline. False when the time is up.
bool reap(pid_t pid, Clock::time_point deadline, int& status, Outcome& outcome) {
  for (;;) {
    rusage used{};
    const pid_t got = wait4(pid, &status, WNOHANG, &used);
    if (got == pid) outcome.cpu_ms += cpu_ms(used);
    if (got == pid || (got < 0 && errno != EINTR)) return true;
    if (Clock::now() >= deadline) return false;
    usleep(500);
  }
}

// Collects the remaining processes of the killed group.
void reap_group(pid_t pid, int& status, Outcome& outcome) {
  rusage used{};
  for (int each = 0;; used = {}) {
    const pid_t got = wait4(-pid, &each, 0, &used);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return;
    outcome.cpu_ms += cpu_ms(used);
    if (got == pid) status = each;
  }
}

}  // namespace

Outcome run_child(const std::function<int(int)>& body, const Limits& limits) {
  Outcome outcome;
  int pipe_fd[2];
  if (pipe2(pipe_fd, O_CLOEXEC) != 0) {
    outcome.output = std::string("cannot make a pipe: ") + std::strerror(errno);
    return outcome;
  }
  prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0);
  const auto start = Clock::now(), deadline = start + std::chrono::milliseconds(limits.wall_ms);
  const pid_t pid = fork();
  if (pid < 0) {
    outcome.output = std::string("cannot start a process: ") + std::strerror(errno);
    close(pipe_fd[0]);
    close(pipe_fd[1]);
    return outcome;
  }
  if (pid == 0) {
    close(pipe_fd[0]);
    child_main(body, pipe_fd[1], limits);
  }
  close(pipe_fd[1]);
  setpgid(pid, pid);  // parent and child both call it: either may run first
  int status = 0;
  outcome.timed_out = !drain(pipe_fd[0], deadline, outcome) || !reap(pid, deadline, status, outcome);
  close(pipe_fd[0]);
  kill(-pid, SIGKILL);  // also its own children
  reap_group(pid, status, outcome);
  outcome.wall_ms = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  outcome.starved = outcome.timed_out && outcome.cpu_ms < 0.5 * std::min(1e3 * limits.cpu_s, 1.0 * limits.wall_ms);
  outcome.signal = WIFSIGNALED(status) ? WTERMSIG(status) : 0;
  outcome.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  if (outcome.signal == SIGXCPU) outcome.timed_out = true;
  return outcome;
}

Outcome run_program(const std::vector<std::string>& argv, const Limits& limits, int stream) {
  std::vector<char*> raw;
  for (const std::string& word : argv) raw.push_back(const_cast<char*>(word.c_str()));
  raw.push_back(nullptr);
  const auto body = [&raw, stream](int out_fd) {
    dup2(out_fd, stream);
    setenv("LC_ALL", "C", 1);  // English messages with plain quotes
    execvp(raw[0], raw.data());
    dprintf(2, "cannot run %s: %s\n", raw[0], std::strerror(errno));
    return 127;
  };
  return run_child(body, limits);
}

std::string starved_text(const std::string& who, const Outcome& outcome) {
  return "the machine is too busy: " + who + " got " + std::to_string(static_cast<int>(outcome.cpu_ms)) +
         " ms of the processor in " + std::to_string(static_cast<int>(outcome.wall_ms)) + " ms";
}

std::string readable(std::string_view symbol) {
  if (!symbol.starts_with("_Z")) return std::string(symbol);  // "f" alone would be read as the type float
  int status = 0;
  char* text = abi::__cxa_demangle(std::string(symbol).c_str(), nullptr, nullptr, &status);
  std::string name = status == 0 ? text : std::string(symbol);
  std::free(text);
  return name;
}

std::string signal_text(int signal) {
  switch (signal) {
    case SIGSEGV:
      return "SIGSEGV (invalid memory access)";
    case SIGFPE:
      return "SIGFPE (integer division by zero or overflow)";
    case SIGILL:
      return "SIGILL (illegal instruction)";
    case SIGBUS:
      return "SIGBUS (misaligned or missing memory)";
    case SIGABRT:
      return "SIGABRT (abort or failed assertion)";
    case SIGKILL:
      return "SIGKILL (killed, or out of memory)";
    default:
      return "signal " + std::to_string(signal) + " (" + strsignal(signal) + ")";
  }
}

}  // namespace lithe::lawd
