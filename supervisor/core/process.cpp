// SPDX-License-Identifier: Apache-2.0
#include "supervisor/core/process.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "spine/core/host/files.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/text.hpp"

namespace lithe::control {
namespace {

constexpr int kExtraFd = 3;

// Direct system calls: the C library's header for these has no C linkage in C++ before glibc 2.37.
int open_pidfd(pid_t pid) { return static_cast<int>(::syscall(SYS_pidfd_open, pid, 0)); }

// What /proc/PID/stat says after the name, which may hold anything: state, parent, group, session ... Empty when the
// process has ended.
std::string stat_of(const std::string& pid) {
  std::string stat;
  std::ifstream file("/proc/" + pid + "/stat");
  std::getline(file, stat, '\0');
  const std::size_t name_end = stat.rfind(") ");
  return name_end == std::string::npos ? "" : stat.substr(name_end + 2);
}

// Runs in the child between fork and exec: only async-signal-safe calls.
[[noreturn]] void become(const Launch& launch, char* const* argv, pid_t parent, int failure_fd) {
  if (launch.own_session) ::setsid();
  if (launch.dies_with_parent) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (::getppid() != parent) ::_exit(127);
  }
  if (launch.idle_priority) {
    ::setpriority(PRIO_PROCESS, 0, 19);
    const sched_param none{};
    ::sched_setscheduler(0, SCHED_IDLE, &none);
  }
  if (!launch.cpus.empty()) (void)set_allowed_cpus(0, launch.cpus);
  sigset_t none;
  sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  ::signal(SIGPIPE, SIG_IGN);  // the reader of its output may end first
  const int null_fd = ::open("/dev/null", O_RDWR | O_CLOEXEC);
  ::dup2(launch.stdin_fd >= 0 ? launch.stdin_fd : null_fd, STDIN_FILENO);
  ::dup2(launch.stdout_fd >= 0 ? launch.stdout_fd : null_fd, STDOUT_FILENO);
  if (launch.stderr_fd >= 0) ::dup2(launch.stderr_fd, STDERR_FILENO);
  if (launch.extra_fd >= 0) {
    // The pipe that reports a failed start may itself have this number.
    failure_fd = ::fcntl(failure_fd, F_DUPFD_CLOEXEC, kExtraFd + 1);
    if (launch.extra_fd != kExtraFd)
      ::dup2(launch.extra_fd, kExtraFd);
    else
      ::fcntl(kExtraFd, F_SETFD, 0);
  }
  ::execv(argv[0], argv);
  const int reason = errno;
  (void)!::write(failure_fd, &reason, sizeof(reason));
  ::_exit(127);
}

}  // namespace

Result<Process> Process::start(const Launch& launch) {
  std::vector<char*> argv;
  for (const std::string& word : launch.argv) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  int pipe_fds[2];
  if (::pipe2(pipe_fds, O_CLOEXEC) != 0)
    return Error{fmt::format("cannot start {}: {}", launch.argv[0], std::strerror(errno))};
  Fd read_end(pipe_fds[0]);
  Fd write_end(pipe_fds[1]);
  const pid_t parent = ::getpid();
  const pid_t pid = ::fork();
  if (pid == 0) become(launch, argv.data(), parent, write_end.get());
  write_end.reset();
  if (pid < 0) return Error{fmt::format("cannot start {}: {}", launch.argv[0], std::strerror(errno))};
  int reason = 0;
  if (::read(read_end.get(), &reason, sizeof(reason)) == sizeof(reason)) {
    ::waitpid(pid, nullptr, 0);
    return Error{
        fmt::format("cannot start {}: {}; is the build complete (make)?", launch.argv[0], std::strerror(reason))};
  }
  return Process(pid, Fd(open_pidfd(pid)), true);
}

Result<Process> Process::adopt(pid_t pid) {
  Fd pidfd(open_pidfd(pid));
  if (!pidfd) return Error{fmt::format("process {} cannot be watched: {}", pid, std::strerror(errno))};
  return Process(pid, std::move(pidfd), false);
}

bool Process::ended() { return wait(0); }

bool Process::wait(int timeout_ms) {
  if (ended_) return true;
  pollfd wait{pidfd_.get(), POLLIN, 0};
  if (::poll(&wait, 1, timeout_ms) <= 0) return false;
  ended_ = true;
  verdict_ = "ended (not our child, so its exit code is unknown)";
  siginfo_t info{};
  if (child_ && ::waitid(P_PIDFD, static_cast<id_t>(pidfd_.get()), &info, WEXITED) == 0) {
    if (info.si_code == CLD_EXITED) {
      exit_code_ = info.si_status;
      verdict_ = fmt::format("exit code {}", info.si_status);
    } else {
      verdict_ = fmt::format("killed by signal {} ({})", info.si_status, ::strsignal(info.si_status));
    }
  }
  return true;
}

void Process::signal(int number) const {
  if (!ended_) ::syscall(SYS_pidfd_send_signal, pidfd_.get(), number, nullptr, 0);
}

Work work_of_session(pid_t leader) {
  Work work;
  bool stopped = false;
  const double tick_s = 1.0 / static_cast<double>(::sysconf(_SC_CLK_TCK));
  for (const std::filesystem::path& path : files_in("/proc")) {
    const std::string pid = path.filename().string();
    if (pid.find_first_not_of("0123456789") != std::string::npos) continue;
    // proc(5): state, parent, group, session, then seven fields to utime, stime, cutime, cstime.
    std::istringstream fields(stat_of(pid));
    char state = '?';
    long parent = 0, group = 0, session = 0, skipped = 0;
    fields >> state >> parent >> group >> session;
    if (session != leader) continue;
    for (int i = 0; i < 7; ++i) fields >> skipped;
    long times[4] = {};
    for (long& each : times) fields >> each;
    for (const long each : times) work.cpu_s += static_cast<double>(each) * tick_s;
    work.wants_to_run = work.wants_to_run || state == 'R' || state == 'D';
    stopped = stopped || (pid == std::to_string(leader) && is_stopped(state));
  }
  work.wants_to_run = work.wants_to_run && !stopped;
  return work;
}

char state_of(pid_t pid) {
  const std::string stat = pid > 0 ? stat_of(std::to_string(pid)) : "";
  return stat.empty() ? '?' : stat.front();
}

std::string command_of(pid_t pid) {
  constexpr std::size_t kMostShown = 100;
  std::string line;
  std::ifstream file(fmt::format("/proc/{}/cmdline", pid));
  for (std::string word; std::getline(file, word, '\0') && line.size() < kMostShown;)
    line += (line.empty() ? "" : " ") + word;
  return printable(line.substr(0, kMostShown));
}

std::vector<int> cores_beside(const std::vector<int>& allowed, int spine_cpu, int transport_cpu) {
  std::vector<int> rest = allowed;
  for (const int taken : {spine_cpu, transport_cpu}) {
    std::vector<int> without = rest;
    std::erase(without, taken);
    if (!without.empty()) rest = std::move(without);
  }
  return rest;
}

Result<> set_affinity(pid_t pid, const std::vector<int>& cpus) {
  if (cpus.empty()) return done();
  const int error = set_allowed_cpus(pid, cpus);
  return error == 0 ? done() : Error{fmt::format("cannot pin process {}: {}", pid, std::strerror(error))};
}

}  // namespace lithe::control
