// SPDX-License-Identifier: Apache-2.0
// Seccomp filters of a trial. Every other system call raises SIGSYS, and its handler reports the number.
#include <fcntl.h>
#include <seccomp.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/prctl.h>

#include <cerrno>
#include <cstring>
#include <initializer_list>
#include <memory>

#include "trial/sandbox/sandbox.hpp"

namespace lithe::trial {
namespace {

// libseccomp leaves out the calls that this machine does not have.
using Names = std::initializer_list<const char*>;
constexpr Names kComputing = {"exit", "exit_group", "rt_sigreturn", "clock_gettime"};
constexpr Names kLoading = {"read",           "pread64",  "fstat",   "newfstatat", "lseek",  "close",     "mmap",
                            "munmap",         "mprotect", "madvise", "brk",        "mremap", "getrandom", "futex",
                            "rt_sigprocmask", "getpid",   "gettid",  "faccessat",  "access"};
// For the parent, and for a child before shed_rights().
constexpr Names kForking = {"write",       "wait4",        "kill",    "ppoll",           "poll",           "pidfd_open",
                            "pipe2",       "dup2",         "dup3",    "close_range",     "prlimit64",      "setitimer",
                            "sigaltstack", "rt_sigaction", "getppid", "set_robust_list", "restart_syscall"};

class Filter {
 public:
  // `otherwise`: action for a call that is not allowed.
  explicit Filter(std::uint32_t otherwise) : filter_(seccomp_init(otherwise), &seccomp_release) {
    // System call numbers of another architecture mean other calls: the process is killed.
    note(seccomp_attr_set(filter_.get(), SCMP_FLTATR_ACT_BADARCH, SCMP_ACT_KILL_PROCESS));
    note(seccomp_attr_set(filter_.get(), SCMP_FLTATR_API_SYSRAWRC, 1));  // errors are the kernel's own
  }

  void allow(Names calls) {
    for (const char* call : calls) allow_if(call, {});
  }

  // Only with one of these values as its first argument.
  void allow_on(const char* call, std::initializer_list<int> firsts) {
    for (const int first : firsts) allow_if(call, {{0, SCMP_CMP_EQ, static_cast<std::uint32_t>(first), 0}});
  }

  // Only with this value as its second argument.
  void allow_second(const char* call, int second) {
    allow_if(call, {{1, SCMP_CMP_EQ, static_cast<std::uint32_t>(second), 0}});
  }

  // Only to read what is there.
  void allow_open_to_read() {
    constexpr std::uint32_t kWrites = O_WRONLY | O_RDWR | O_CREAT | O_TRUNC | O_APPEND;
    allow_if("openat", {{2, SCMP_CMP_MASKED_EQ, kWrites, 0}});
  }

  // Installing another filter, with libseccomp: what is allowed can only get less.
  void allow_less() { allow_if("seccomp", {{0, SCMP_CMP_EQ, SECCOMP_SET_MODE_FILTER, 0}, {1, SCMP_CMP_EQ, 0, 0}}); }

  Result<> install() {
    if (failed_ == 0) note(seccomp_load(filter_.get()));
    if (failed_ == 0) return done();
    return Error{std::string("this kernel refuses the filter of system calls: ") + std::strerror(-failed_)};
  }

 private:
  void allow_if(const char* call, std::initializer_list<scmp_arg_cmp> all_hold) {
    note(seccomp_rule_add_array(filter_.get(), SCMP_ACT_ALLOW, seccomp_syscall_resolve_name(call),
                                static_cast<unsigned>(all_hold.size()), all_hold.begin()));
  }
  void note(int result) {
    if (result < 0) failed_ = result;
  }

  std::unique_ptr<void, decltype(&seccomp_release)> filter_;
  int failed_ = 0;
};

}  // namespace

Result<> allow_loading_only(int pipe_fd) {
  Filter filter(SCMP_ACT_TRAP);
  filter.allow(kComputing);
  filter.allow(kLoading);
  filter.allow_on("write", {pipe_fd});
  filter.allow_on("prctl", {PR_SET_NO_NEW_PRIVS, kSyscallUserDispatch});
  filter.allow_less();
  filter.allow_open_to_read();
  return filter.install();
}

Result<> allow_computing_only(int pipe_fd) {
  Filter filter(SCMP_ACT_TRAP);
  filter.allow(kComputing);
  filter.allow_on("write", {pipe_fd});
  return filter.install();
}

Result<> allow_trials_only() {
  Filter filter(SCMP_ACT_ERRNO(EPERM));
  filter.allow(kComputing);
  filter.allow(kLoading);
  filter.allow(kForking);
  filter.allow_open_to_read();
  filter.allow_on("clone", {CLONE_CHILD_SETTID | CLONE_CHILD_CLEARTID | SIGCHLD});  // fork(), and no thread
  filter.allow_on("prctl", {kSyscallUserDispatch, PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS, PR_SET_DUMPABLE});
  // A child asks whether the robot runs before it reads its telemetry (ipc::Lease::is_held).
  filter.allow_second("flock", LOCK_SH | LOCK_NB);
  filter.allow_less();
  return filter.install();
}

}  // namespace lithe::trial
