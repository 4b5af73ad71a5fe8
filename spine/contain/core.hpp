// SPDX-License-Identifier: Apache-2.0
// The words of a Cell: shared by run(), the signal handlers on its thread, and the Watchdog. Private to this room.
#pragma once

#include <setjmp.h>
#include <signal.h>
#include <sys/types.h>
#include <time.h>

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "spine/contain/cell.hpp"
#include "spine/contain/environment.hpp"
#include "spine/contain/law_stack.hpp"
#include "spine/contain/memory_key.hpp"
#include "spine/contain/vault.hpp"

namespace lithe::contain {

struct Core {
  // Read by the Watchdog. A call's serial number tells it from every other: one tick may run several laws.
  alignas(64) std::atomic<std::uint64_t> call{0};  // 0 = none runs
  std::atomic<std::int64_t> deadline_ns{0};
  std::atomic<std::uint64_t> noticed{0};  // the last call that took a notice: its thread runs, and so does the call

  // The thread's own, and its handlers'.
  alignas(64) std::uint64_t serial = 0;
  volatile std::uint8_t system_calls = 0;  // the kernel reads it: 0 = allowed, 1 = each one is a SIGSYS
  bool gated = false;
  std::atomic<std::uint64_t> late_signals{0};
  Vault* vault = nullptr;
  bool guards = false;  // the vault's guarded blocks are this thread's
  MemoryKey key;
  Environment environment;
  Trouble trouble;
  sigjmp_buf back;
  LawStack law_stack;

  // Set once.
  pid_t thread = 0;
  clockid_t cpu_clock = CLOCK_THREAD_CPUTIME_ID;  // the thread's, for others to read
  Watchdog* watchdog = nullptr;
  Constants* constants = nullptr;  // they watch this thread's Entrance
  void* mapping = nullptr;         // [guard page][alternate stack][this, unless in the vault]
  std::size_t mapping_bytes = 0;
  stack_t stack_before{};
  sigset_t mask{};  // signals that the thread blocks itself
};

// What a handler finds before it may touch a vault: a thread's own, in ordinary memory.
struct Entrance {
  Core* core = nullptr;
  MemoryKey key;
};
Entrance& entrance() noexcept;

// The Watchdog's signal. Its value is what it asks for and the serial number of the call it asks.
enum class Ask : std::uint8_t { notice, end };
int watch_signal() noexcept;
siginfo_t watch_message(std::uint64_t serial, Ask ask) noexcept;
bool send_watch_signal(pid_t thread, std::uint64_t serial, Ask ask) noexcept;

// A signal is sent from another core: when it arrives, the call it is for may be over, and the next one running.
struct SameCall {
  static bool is_meant(std::uint64_t wanted, std::uint64_t running) LITHE_RT {
    return running != 0 && wanted == running;
  }
};

// Handler of the Watchdog's signal; the rule is a parameter so that the test can show what the wrong one does.
template <class Rule>
void on_watch_signal(int signal, siginfo_t* info, void* context) noexcept;

// Gives the thread's system calls back for good, before the word the kernel looks at goes away.
void stop_dispatch() noexcept;

// Whoever clears `call` has the call. What was pending behind this handler finds none running.
inline void claim(Core& core) noexcept {
  core.system_calls = 0;
  core.call.store(0, std::memory_order_relaxed);
  std::atomic_signal_fence(std::memory_order_seq_cst);
}

// Ends the claimed call: run() returns with this trouble.
[[noreturn]] void break_off(Core& core, const Trouble& trouble) noexcept;
std::uint64_t program_counter(const void* context) noexcept;

template <class Rule>
void on_watch_signal(int, siginfo_t* info, void* context) noexcept {
  Environment::allow_unaligned();
  const Entrance& here = entrance();
  here.key.allow_writes();
  if (here.core == nullptr) return;
  Core& core = *here.core;
  const auto value = reinterpret_cast<std::uintptr_t>(info->si_value.sival_ptr);
  const std::uint64_t wanted = value >> 1;
  if (info->si_code != SI_QUEUE || !Rule::is_meant(wanted, core.call.load(std::memory_order_relaxed))) {
    core.late_signals.fetch_add(1, std::memory_order_relaxed);
    return;
  }
  if (static_cast<Ask>(value & 1) == Ask::notice) {
    core.noticed.store(wanted, std::memory_order_relaxed);
    return;
  }
  claim(core);
  break_off(core, {wire::LawFaultKind::overran, program_counter(context), 0});
}

}  // namespace lithe::contain
