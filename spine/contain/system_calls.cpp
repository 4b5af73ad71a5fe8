// SPDX-License-Identifier: Apache-2.0
// Blocks the system calls of laws.
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstring>
#include <string>
#include <vector>

#include "spine/contain/core.hpp"
#include "spine/contain/fault_barrier.hpp"

namespace lithe::contain {
namespace {

// Allowed: waits and futexes, end of a thread, return of a handler, and the calls of abort() and pass_on().
constexpr int kNeeded[] = {SYS_clock_nanosleep, SYS_nanosleep,    SYS_clock_gettime, SYS_futex,  SYS_restart_syscall,
                           SYS_madvise,         SYS_munmap,       SYS_sigaltstack,   SYS_exit,   SYS_rt_sigreturn,
                           SYS_rt_sigprocmask,  SYS_rt_sigaction, SYS_getpid,        SYS_gettid, SYS_sched_yield};

#if defined(__x86_64__)
constexpr std::uint32_t kMachine = AUDIT_ARCH_X86_64;
#else
constexpr std::uint32_t kMachine = AUDIT_ARCH_AARCH64;
#endif

#if defined(__x86_64__)
// The address of the two instructions with which every handler returns: they must work while calls are blocked. Read
// with the raw sigaction system call, because glibc hides it.
struct Restorer {
  std::uintptr_t from = 0;
  static constexpr unsigned long kBytes = 16;  // mov $15, %rax; syscall; the code after it is never reached
};

Result<Restorer> find_restorer() {
  struct {
    void* handler;
    unsigned long flags;
    std::uintptr_t restorer;
    std::uint64_t mask;
  } action{};
  if (syscall(SYS_rt_sigaction, watch_signal(), nullptr, &action, sizeof action.mask) != 0 || action.restorer == 0)
    return Error{"the handlers are not installed: call install_handlers() first"};
  return Restorer{action.restorer};
}

constexpr int kDispatch = 59, kOff = 0, kOn = 1;  // PR_SET_SYSCALL_USER_DISPATCH, which older headers lack

Result<> dispatch_here(Core& core) {
  const Result<Restorer> restorer = find_restorer();
  if (!restorer) return restorer.error();
  if (prctl(kDispatch, kOn, restorer->from, Restorer::kBytes, &core.system_calls) == 0) return done();
  return Error{std::string("syscall user dispatch was refused: ") + std::strerror(errno)};
}
#else
Result<> dispatch_here(Core&) { return Error{"syscall user dispatch exists on x86 only"}; }
#endif

sock_filter step(unsigned code, std::uint32_t value, std::size_t if_true = 0, std::size_t if_false = 0) {
  return {static_cast<std::uint16_t>(code), static_cast<std::uint8_t>(if_true), static_cast<std::uint8_t>(if_false),
          value};
}

// Allowed numbers pass, tgkill to this very thread passes, everything else is a SIGSYS.
std::vector<sock_filter> make_filter(std::span<const int> also) {
  constexpr unsigned kLoad = BPF_LD | BPF_W | BPF_ABS, kEqual = BPF_JMP | BPF_JEQ | BPF_K, kReturn = BPF_RET | BPF_K;
  const auto thread = static_cast<std::uint32_t>(syscall(SYS_gettid));
  std::vector<sock_filter> filter{step(kLoad, offsetof(seccomp_data, arch)), step(kEqual, kMachine, 1, 0),
                                  step(kReturn, SECCOMP_RET_TRAP), step(kLoad, offsetof(seccomp_data, nr))};
  const auto let_pass = [&filter](int number) {
    filter.push_back(step(kEqual, static_cast<std::uint32_t>(number), 0, 1));
    filter.push_back(step(kReturn, SECCOMP_RET_ALLOW));
  };
  for (const int number : kNeeded) let_pass(number);
  for (const int number : also) let_pass(number);
  filter.push_back(step(kEqual, SYS_tgkill, 0, 3));
  filter.push_back(step(kLoad, offsetof(seccomp_data, args) + sizeof(std::uint64_t)));  // its second: the thread
  filter.push_back(step(kEqual, thread, 0, 1));
  filter.push_back(step(kReturn, SECCOMP_RET_ALLOW));
  filter.push_back(step(kReturn, SECCOMP_RET_TRAP));
  return filter;
}

Result<> filter_here(std::span<const int> also) {
  std::vector<sock_filter> steps = make_filter(also);
  const sock_fprog program{static_cast<unsigned short>(steps.size()), steps.data()};
  if (prctl(PR_SET_NO_NEW_PRIVS, 1ul, 0ul, 0ul, 0ul) == 0 && prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0)
    return done();
  return Error{std::string("seccomp was refused: ") + std::strerror(errno)};
}

}  // namespace

void stop_dispatch() noexcept {
#if defined(__x86_64__)
  prctl(kDispatch, kOff, 0ul, 0ul, 0ul);
#endif
}

Result<CallGate> FaultBarrier::forbid_system_calls(std::span<const int> also, CallGate wanted) {
  if (wanted == CallGate::none) return CallGate::none;
  if (wanted == CallGate::dispatch && dispatch_system_calls() == CallGate::dispatch) return CallGate::dispatch;
  const Result<> filter = filter_here(also);
  if (filter) return CallGate::filter;
  return Error{filter.message() + "; laws are kept from the kernel by admission alone"};
}

CallGate FaultBarrier::dispatch_system_calls() {
  core_->gated = dispatch_here(*core_).operator bool();
  return core_->gated ? CallGate::dispatch : CallGate::none;
}

}  // namespace lithe::contain
