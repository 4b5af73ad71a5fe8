// SPDX-License-Identifier: Apache-2.0
// The signal handlers: recognise a fault inside a law, and jump back into run().
#undef _FORTIFY_SOURCE  // its siglongjmp makes a system call when it leaves the alternate stack
#include <setjmp.h>
#include <signal.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <mutex>
#include <string>

#include "spine/contain/core.hpp"
#include "spine/contain/fault_barrier.hpp"

namespace lithe::contain {

using wire::LawFaultKind;

namespace {

struct Kind {
  int signal;
  LawFaultKind kind;
};
constexpr std::array<Kind, 7> kFaults{{{SIGSEGV, LawFaultKind::bad_access},
                                       {SIGBUS, LawFaultKind::bus_error},
                                       {SIGFPE, LawFaultKind::arithmetic},
                                       {SIGILL, LawFaultKind::illegal_instruction},
                                       {SIGABRT, LawFaultKind::aborted},
                                       {SIGTRAP, LawFaultKind::trapped},
                                       {SIGSYS, LawFaultKind::system_call}}};
constexpr int kKeyFault = 4;  // SEGV_PKUERR, which older headers lack

std::array<struct sigaction, kFaults.size()> g_before{};

// initial-exec: access must not call the dynamic linker, because the law may have failed inside it.
[[gnu::tls_model("initial-exec")]] constinit thread_local Entrance t_entrance;

// True for signals of the kernel, and for abort() and raise() of this process; false for signals from other processes.
bool comes_from_here(const siginfo_t& info) {
  return info.si_code > 0 || (info.si_code == SI_TKILL && info.si_pid == getpid());
}

Failure describe(std::size_t which, const siginfo_t& info, const void* context) {
  Failure failure{kFaults[which].kind, program_counter(context), 0};
  const int signal = kFaults[which].signal;
  if (signal == SIGSEGV && info.si_code == kKeyFault) failure.kind = LawFaultKind::state_broken;
  if (signal == SIGSEGV || signal == SIGBUS) failure.address = reinterpret_cast<std::uintptr_t>(info.si_addr);
  if (signal != SIGSYS) return failure;
  failure.pc = reinterpret_cast<std::uintptr_t>(info.si_call_addr);
  failure.address = static_cast<std::uint32_t>(info.si_syscall);
  return failure;
}

// Passes the signal to the previous handler. A faulting instruction is executed again with unchanged registers, now
// under the old handler; a signal that would not occur again is sent again.
void pass_on(std::size_t which, const siginfo_t& info) {
  const int signal = kFaults[which].signal;
  sigaction(signal, &g_before[which], nullptr);
  const bool comes_back = info.si_code > 0 && signal != SIGTRAP && signal != SIGSYS && signal != SIGABRT;
  if (!comes_back) raise(signal);
}

void on_fault(int signal, siginfo_t* info, void* context) noexcept {
  Environment::allow_unaligned();
  std::size_t which = 0;
  while (kFaults[which].signal != signal) ++which;
  const Entrance& here = t_entrance;
  here.key.allow_writes();  // the kernel starts a handler with all keys but the first closed
  const bool inside = here.core != nullptr && here.core->call.load(std::memory_order_relaxed) != 0;
  if (inside) {
    here.core->system_calls = 0;
    if (comes_from_here(*info)) {
      claim(*here.core);
      break_off(*here.core, describe(which, *info, context));
    }
  }
  pass_on(which, *info);
}

Result<> install(int signal, void (*handler)(int, siginfo_t*, void*), struct sigaction* before) {
  struct sigaction action{};
  action.sa_sigaction = handler;
  action.sa_flags = SA_ONSTACK | SA_SIGINFO;
  sigfillset(&action.sa_mask);  // one at a time: a fault inside a handler ends the process
  if (sigaction(signal, &action, before) == 0) return done();
  return Error{"no handler for signal " + std::to_string(signal) + ": " + std::strerror(errno)};
}

Result<> install_all() {
  for (std::size_t i = 0; i < kFaults.size(); ++i)
    if (Result<> installed = install(kFaults[i].signal, on_fault, &g_before[i]); !installed) return installed;
  return install(watch_signal(), on_watch_signal<SameCall>, nullptr);
}

}  // namespace

Entrance& entrance() noexcept { return t_entrance; }

int watch_signal() noexcept { return SIGRTMIN + 3; }

void break_off(Core& core, const Failure& failure) noexcept {
  core.failure = failure;
  pthread_sigmask(SIG_SETMASK, &core.mask,
                  nullptr);  // here and not in siglongjmp: otherwise sigsetjmp would need a system call too
  siglongjmp(core.back, 1);
}

Result<> install_handlers() {
  static std::mutex once;
  static bool installed = false;
  const std::lock_guard lock(once);
  if (installed) return done();
  Result<> result = install_all();
  installed = static_cast<bool>(result);
  return result;
}

}  // namespace lithe::contain
