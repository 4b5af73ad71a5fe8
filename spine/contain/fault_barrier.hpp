// SPDX-License-Identifier: Apache-2.0
// Fault barrier: runs a law and returns to the caller also when the law crashes or does not end.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "spine/contain/memory/protected_memory.hpp"
#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::contain {

struct Core;
class Constants;
class Watchdog;

// Result of a call.
struct Failure {
  wire::LawFaultKind kind = wire::LawFaultKind::none;
  std::uint64_t pc = 0;       // 0 = unknown
  std::uint64_t address = 0;  // the accessed address, or the system call number; 0 = unknown

  explicit operator bool() const LITHE_RT { return kind != wire::LawFaultKind::none; }
};

// Once per process, before the first call: handlers for SEGV BUS FPE ILL ABRT TRAP SYS and for the Watchdog's signal. A
// fault outside a contained call is passed on to the previous handler, which normally ends the process with that
// signal: faults of our own code are not hidden.
// Contract: off the tick · may be repeated
Result<> install_handlers();

// How system calls of a law are blocked.
enum class CallGate : std::uint8_t {
  none,
  dispatch,  // syscall user dispatch (x86): blocks every call of a law and none of the thread itself
  filter,    // seccomp: a law can still make the calls that the thread itself needs (README)
};

// One per contained thread. The callback is a plain function pointer, so the compiler's effect analysis ends at the
// law.
// Contract: made, used and destroyed on one thread, which blocks every other signal that has a handler before it opens
// its FaultBarrier, and changes its mask no more · run() RT
class FaultBarrier {
 public:
  using Call = void (*)(void* context);

  // An alternate stack for the handlers, behind a guard page, touched and locked. With a protected memory the
  // FaultBarrier's own data is in it, and the protected memory is closed while a law runs. The processor's present
  // rounding and denormal modes are the ones restored later.
  static Result<FaultBarrier> open(ProtectedMemory* protected_memory = nullptr);
  FaultBarrier(FaultBarrier&&) = default;

  // Blocks system calls inside run(). `also`: calls that a seccomp filter must allow because this thread makes them,
  // besides waiting, futexes and exit. A filter cannot be removed.
  Result<CallGate> forbid_system_calls(std::span<const int> also = {}, CallGate wanted = CallGate::dispatch);

  // The same without a filter, for a thread that makes system calls. Returns none when the machine has no syscall user
  // dispatch.
  CallGate dispatch_system_calls();

  // Registers memory that only this thread writes, never during a call. It is compared around every call when the
  // protected memory has no keys (see ProtectedMemory::guard). Without a protected memory this does nothing.
  Result<> guard(void* block, std::size_t bytes);

  // Registers with `constants` the data that a handler reads first: it is outside the protected memory and must not
  // change until the FaultBarrier is destroyed.
  Result<> watch_entrance(Constants& constants);

  // Runs call(context). Failure::kind is none when the call returned by itself; otherwise it was ended where it was,
  // after `deadline_ns` [CLOCK_MONOTONIC] by a Watchdog that charges CPU time. Not reentrant. No system call unless
  // there is a fault.
  Failure run(std::int64_t deadline_ns, Call call, void* context) LITHE_RT;

  // Number of Watchdog signals that arrived after their call had ended, and were ignored.
  std::uint64_t late_signals() const LITHE_RT;

 private:
  friend class Watchdog;
  struct Close {
    void operator()(Core* core) const;
  };
  explicit FaultBarrier(Core* core) : core_(core) {}
  std::unique_ptr<Core, Close> core_;
};

}  // namespace lithe::contain
