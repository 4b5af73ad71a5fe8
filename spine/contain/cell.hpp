// SPDX-License-Identifier: Apache-2.0
// Runs a law so that whatever it does, the thread comes back.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "spine/contain/vault.hpp"
#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::contain {

struct Core;
class Constants;
class Watchdog;

// What happened in a call.
struct Trouble {
  wire::LawFaultKind kind = wire::LawFaultKind::none;
  std::uint64_t pc = 0;       // 0 = unknown
  std::uint64_t address = 0;  // what was touched, or the number of the system call; 0 = unknown

  explicit operator bool() const LITHE_RT { return kind != wire::LawFaultKind::none; }
};

// Once per process, before the first call: handlers for SEGV BUS FPE ILL ABRT TRAP SYS and for the Watchdog's signal. A
// fault outside a contained call goes on to what was installed before, as a rule the end of the process with that
// signal: our own mistakes are not hidden.
// Contract: off the tick · may be repeated
Result<> install_handlers();

// How a thread is kept from the kernel while a law runs.
enum class CallGate : std::uint8_t {
  none,
  dispatch,  // Linux's syscall user dispatch (x86): every call of a law is a fault, and of the thread itself none
  filter,    // seccomp: a law can still make the few calls that the thread itself needs (README)
};

// One per contained thread. A call is a plain function: the analysis of effects ends where a law begins.
// Contract: made, used and destroyed on one thread, which blocks every other signal that has a handler before it opens
// its Cell, and changes its mask no more · run() RT
class Cell {
 public:
  using Call = void (*)(void* context);

  // An alternate stack for the handlers, behind a guard page, touched and locked. With a vault the Cell's own words lie
  // in it, and it is shut while a law runs. The processor's rounding and denormal modes now are those restored later.
  static Result<Cell> open(Vault* vault = nullptr);
  Cell(Cell&&) = default;

  // Allows the thread system calls outside run() only. `also` names those that a filter must let pass because this
  // thread makes them, beside waiting, futexes and ending. There is no way back for a filter.
  Result<CallGate> forbid_system_calls(std::span<const int> also = {}, CallGate wanted = CallGate::dispatch);

  // The same without a filter, for a thread that makes calls of its own. none: this machine has no dispatch.
  CallGate dispatch_system_calls();

  // What this thread alone writes, and nobody while a law runs: compared around every call where the vault has no keys
  // (see Vault::guard). Without a vault nothing is done.
  Result<> guard(void* block, std::size_t bytes);

  // What a handler finds first lies outside the vault, and must not change until the Cell is destroyed.
  Result<> watch_entrance(Constants& constants);

  // Runs call(context). Trouble::kind is none when it came back by itself; else the call was cut off where it was,
  // after `deadline_ns` [CLOCK_MONOTONIC] by a Watchdog that charges CPU time. Not reentrant. No system call on the
  // good path.
  Trouble run(std::int64_t deadline_ns, Call call, void* context) LITHE_RT;

  // How often a Watchdog's signal came for a call that was over, and did nothing.
  std::uint64_t late_signals() const LITHE_RT;

 private:
  friend class Watchdog;
  struct Close {
    void operator()(Core* core) const;
  };
  explicit Cell(Core* core) : core_(core) {}
  std::unique_ptr<Core, Close> core_;
};

}  // namespace lithe::contain
