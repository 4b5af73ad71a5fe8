// SPDX-License-Identifier: Apache-2.0
// Seccomp filters of a trial. Every other system call raises SIGSYS, and its handler reports the number.
#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sched.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>

#include <cerrno>
#include <cstddef>
#include <cstring>
#include <initializer_list>
#include <span>
#include <vector>

#include "trial/sandbox/gate.hpp"
#include "trial/sandbox/sandbox.hpp"

namespace lithe::trial {
namespace {

#if defined(__x86_64__)
constexpr std::uint32_t kMachine = AUDIT_ARCH_X86_64;
#else
constexpr std::uint32_t kMachine = AUDIT_ARCH_AARCH64;
#endif

constexpr int kComputing[] = {SYS_exit, SYS_exit_group, SYS_rt_sigreturn, SYS_clock_gettime};
constexpr int kLoading[] = {
    SYS_read,      SYS_pread64, SYS_fstat,          SYS_newfstatat, SYS_lseek,  SYS_close,
    SYS_mmap,      SYS_munmap,  SYS_mprotect,       SYS_madvise,    SYS_brk,    SYS_mremap,
    SYS_getrandom, SYS_futex,   SYS_rt_sigprocmask, SYS_getpid,     SYS_gettid, SYS_faccessat,
#if defined(__x86_64__)
    SYS_access,
#endif
};

// For the parent, and for a child before shed_rights().
constexpr int kForking[] = {
    SYS_write,       SYS_wait4,        SYS_kill,        SYS_ppoll,           SYS_pidfd_open,
    SYS_pipe2,       SYS_dup3,         SYS_close_range, SYS_prlimit64,       SYS_setitimer,
    SYS_sigaltstack, SYS_rt_sigaction, SYS_getppid,     SYS_set_robust_list, SYS_restart_syscall,
#if defined(__x86_64__)
    SYS_poll,        SYS_dup2,
#endif
};

class Filter {
 public:
  // `otherwise`: action for a call that is not allowed.
  explicit Filter(std::uint32_t otherwise) : otherwise_(otherwise) {
    load(offsetof(seccomp_data, arch));
    // System call numbers of another architecture mean other calls: the process is killed.
    add({BPF_JMP | BPF_JEQ | BPF_K, 1, 0, kMachine});
    add({BPF_RET | BPF_K, 0, 0, SECCOMP_RET_KILL_PROCESS});
    load(offsetof(seccomp_data, nr));
  }

  void allow(std::span<const int> calls) {
    for (const int call : calls) {
      add({BPF_JMP | BPF_JEQ | BPF_K, 0, 1, static_cast<std::uint32_t>(call)});
      add({BPF_RET | BPF_K, 0, 0, SECCOMP_RET_ALLOW});
    }
  }

  // Only with one of these values as its first argument.
  void allow_on(int call, std::initializer_list<int> firsts) {
    add({BPF_JMP | BPF_JEQ | BPF_K, 0, static_cast<std::uint8_t>(2 + 2 * firsts.size()),
         static_cast<std::uint32_t>(call)});
    load(offsetof(seccomp_data, args));
    for (const int first : firsts) {
      add({BPF_JMP | BPF_JEQ | BPF_K, 0, 1, static_cast<std::uint32_t>(first)});
      add({BPF_RET | BPF_K, 0, 0, SECCOMP_RET_ALLOW});
    }
    add({BPF_RET | BPF_K, 0, 0, otherwise_});
  }

  // Only to read what is there.
  void allow_open_to_read() {
    constexpr std::uint32_t kWrites = O_WRONLY | O_RDWR | O_CREAT | O_TRUNC | O_APPEND;
    add({BPF_JMP | BPF_JEQ | BPF_K, 0, 4, static_cast<std::uint32_t>(SYS_openat)});
    load(offsetof(seccomp_data, args) + 2 * sizeof(std::uint64_t));
    add({BPF_JMP | BPF_JSET | BPF_K, 1, 0, kWrites});
    add({BPF_RET | BPF_K, 0, 0, SECCOMP_RET_ALLOW});
    add({BPF_RET | BPF_K, 0, 0, otherwise_});
  }

  Result<> install() {
    add({BPF_RET | BPF_K, 0, 0, otherwise_});
    const sock_fprog program{static_cast<unsigned short>(code_.size()), code_.data()};
    if (prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0) return done();
    return Error{std::string("this kernel refuses the filter of system calls: ") + std::strerror(errno)};
  }

 private:
  void load(std::size_t offset) { add({BPF_LD | BPF_W | BPF_ABS, 0, 0, static_cast<std::uint32_t>(offset)}); }
  void add(sock_filter line) { code_.push_back(line); }

  std::uint32_t otherwise_;
  std::vector<sock_filter> code_;
};

}  // namespace

Result<> allow_loading_only(int pipe_fd) {
  Filter filter(SECCOMP_RET_TRAP);
  filter.allow(kComputing);
  filter.allow(kLoading);
  filter.allow_on(SYS_write, {pipe_fd});
  filter.allow_on(SYS_prctl, {PR_SET_SECCOMP, kSyscallUserDispatch});  // to allow less
  filter.allow_open_to_read();
  return filter.install();
}

Result<> allow_computing_only(int pipe_fd) {
  Filter filter(SECCOMP_RET_TRAP);
  filter.allow(kComputing);
  filter.allow_on(SYS_write, {pipe_fd});
  return filter.install();
}

Result<> allow_trials_only() {
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return Error{"cannot give up new privileges"};
  Filter filter(SECCOMP_RET_ERRNO | EPERM);
  filter.allow(kComputing);
  filter.allow(kLoading);
  filter.allow(kForking);
  filter.allow_open_to_read();
  filter.allow_on(SYS_clone, {CLONE_CHILD_SETTID | CLONE_CHILD_CLEARTID | SIGCHLD});  // fork(), and no thread
  filter.allow_on(SYS_prctl,
                  {PR_SET_SECCOMP, kSyscallUserDispatch, PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS, PR_SET_DUMPABLE});
  return filter.install();
}

}  // namespace lithe::trial
