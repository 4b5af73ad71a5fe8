// SPDX-License-Identifier: Apache-2.0
// Watchdog: ends a law that exceeds its time budget.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <ctime>
#include <mutex>

#include "spine/contain/fault_barrier.hpp"
#include "spine/core/pinned.hpp"
#include "spine/core/result.hpp"

namespace lithe::contain {

// The CPU time of a thread [ns]; -1 = not known.
std::int64_t cpu_time_ns(clockid_t thread) noexcept;

// Timing of a Watchdog. A call that it sees before its deadline is ended exactly at the deadline, so one look per
// budget is enough. A call that it sees later runs up to one look and `grace_ns` too long.
struct WatchdogConfig {
  std::int64_t look_every_ns = 100'000;         // 0 = spin: needs a core of its own
  std::int64_t idle_after_ns = 100'000'000;     // without a call for this long it is idle ...
  std::int64_t idle_look_every_ns = 1'000'000;  // ... and looks at this interval, also for the first call
  std::int64_t grace_ns = 300'000;              // CPU time for a call that is seen too late: about one budget
  std::int64_t notice_ns = 25'000;              // CPU time after a call has confirmed its notice
  std::int64_t most_wall_ns = 100'000'000;      // a call ends this long after its deadline in any case
  std::int64_t (*cpu_ns)(clockid_t thread) noexcept = &cpu_time_ns;  // replaced by the wall clock in a test
};

inline constexpr std::size_t kMaxWatched = 4;
enum class Ask : std::uint8_t;  // core.hpp

// Body of a thread on another core than the FaultBarriers', with the same priority: while it does not run, an endless
// law is not ended. From the first look on, a call is charged with the CPU time of its thread: a call whose thread was
// preempted past the deadline may continue; a call that waits in the kernel ends after `most_wall_ns`. Time before the
// first look counts as CPU time, unless the Watchdog was late itself. When a hypervisor takes the core, the thread's
// CPU clock runs on. So a call that has used up its budget first gets a notice: a signal whose handler returns, which
// proves that the thread runs. A law that was only preempted ends well within the `notice_ns` that follow.
// Contract: off the tick · watch() and forget() from any thread · outlives the FaultBarriers it watches
class Watchdog : Pinned {
 public:
  explicit Watchdog(const WatchdogConfig& config = {}) : config_(config) {}

  // Until the FaultBarrier is destroyed.
  Result<> watch(FaultBarrier& barrier);

  void run(const std::atomic<bool>& stop) noexcept;

  // One look. Returns how long the next one may wait [ns].
  std::int64_t look(std::int64_t now_ns) noexcept;

  std::uint64_t signals_sent() const { return sent_.load(std::memory_order_relaxed); }

 private:
  friend class FaultBarrier;
  void forget(const Core& core);

  struct Watched {
    Core* core = nullptr;
    const ProtectedMemory* protected_memory = nullptr;  // the protected memory that holds the core
    std::int64_t deadline_ns = 0;                       // at the last look
    std::uint64_t met = 0;                              // the call that the next three are about
    std::int64_t met_ns = 0;                            // time of the first look at it
    std::int64_t met_cpu_ns = -1;                       // its thread's CPU time at that look
    std::int64_t left_ns = 0;                           // CPU time left from then on
    bool noticed = false;                               // it has confirmed its notice: left_ns is final
    std::uint64_t told = 0;                             // the call that the last signal was sent to, ...
    Ask asked{};                                        // ... its request, ...
    std::int64_t again_ns = 0;                          // ... and the time to send it again
  };
  std::int64_t look_at(Watched& watched, std::int64_t now_ns, bool on_time) noexcept;
  void open_account(Watched& watched, std::int64_t now_ns, std::int64_t left_ns) const noexcept;
  std::int64_t left_of(const Watched& watched, std::int64_t wall_ns, std::int64_t now_ns) const noexcept;
  void tell(Watched& watched, std::uint64_t call, Ask ask, std::int64_t now_ns) noexcept;

  WatchdogConfig config_;
  std::mutex mutex_;  // never the tick's
  std::array<Watched, kMaxWatched> watched_{};
  std::int64_t last_call_ns_ = 0;
  std::int64_t last_look_ns_ = 0;
  std::atomic<std::uint64_t> sent_{0};
};

}  // namespace lithe::contain
