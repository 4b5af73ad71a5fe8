// SPDX-License-Identifier: Apache-2.0
// The data of a FaultBarrier: shared by run(), the signal handlers on its thread, and the Watchdog. Private to this
// room.
#pragma once

#include <setjmp.h>
#include <signal.h>
#include <sys/types.h>
#include <time.h>

#include <atomic>
#include <cstdint>

#include "spine/contain/environment.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/contain/law_stack.hpp"
#include "spine/contain/memory/memory_key.hpp"
#include "spine/contain/memory/protected_memory.hpp"
#include "spine/core/host/signals.hpp"

namespace lithe::contain {

struct Core {
  // Read by the Watchdog. A serial number identifies the call: one tick may run several laws.
  alignas(64) std::atomic<std::uint64_t> call{0};  // 0 = none runs
  std::atomic<std::int64_t> deadline_ns{0};
  std::atomic<std::uint64_t> noticed{0};  // the last call that confirmed a notice: its thread is running

  // Used by the thread and its handlers only.
  alignas(64) std::uint64_t serial = 0;
  volatile std::uint8_t system_calls = 0;  // the kernel reads it: 0 = allowed, 1 = each one is a SIGSYS
  bool gated = false;
  std::atomic<std::uint64_t> late_signals{0};
  ProtectedMemory* protected_memory = nullptr;
  bool guards = false;  // this thread owns the protected memory's guarded blocks
  MemoryKey key;
  Environment environment;
  Failure failure;
  sigjmp_buf back;
  LawStack law_stack;

  // Set once.
  pid_t thread = 0;
  clockid_t cpu_clock = CLOCK_THREAD_CPUTIME_ID;  // the thread's, for others to read
  Watchdog* watchdog = nullptr;
  Constants* constants = nullptr;  // they watch this thread's Entrance
  Mapping mapping;                 // [guard page][alternate stack][this, unless in the protected memory]
  stack_t stack_before{};
  sigset_t mask{};  // signals that the thread blocks itself
};

// What a handler needs before it can access the protected memory: one per thread, in ordinary memory.
struct Entrance {
  Core* core = nullptr;
  MemoryKey key;
};
Entrance& entrance() noexcept;

// The Watchdog's signal. Its value holds the request and the serial number of the call.
enum class Ask : std::uint8_t { notice, end };
int watch_signal() noexcept;
siginfo_t watch_message(std::uint64_t serial, Ask ask) noexcept;
bool send_watch_signal(pid_t thread, std::uint64_t serial, Ask ask) noexcept;

// The signal is sent from another core: when it arrives, its call may have ended and the next one may be running.
struct SameCall {
  static bool is_meant(std::uint64_t wanted, std::uint64_t running) LITHE_RT {
    return running != 0 && wanted == running;
  }
};

// Allows the thread's system calls again, before the selector word that the kernel reads is freed.
void stop_dispatch() noexcept;

// The handler that clears `call` owns its end. A signal that is still pending then finds no running call.
inline void claim(Core& core) noexcept {
  core.system_calls = 0;
  core.call.store(0, std::memory_order_relaxed);
  std::atomic_signal_fence(std::memory_order_seq_cst);
}

// Ends the claimed call: run() returns with this fault.
[[noreturn]] void break_off(Core& core, const Failure& failure) noexcept;

// Handler of the Watchdog's signal. The rule is a parameter, so that a test can show what a wrong rule does.
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
