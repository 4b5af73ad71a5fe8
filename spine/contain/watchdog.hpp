// SPDX-License-Identifier: Apache-2.0
// Breaks off a law that does not come back.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <ctime>
#include <mutex>

#include "spine/contain/cell.hpp"
#include "spine/core/result.hpp"

namespace lithe::contain {

// The CPU time of a thread [ns], as its clock says it; -1 = not known.
std::int64_t cpu_time_ns(clockid_t thread) noexcept;

// How closely a Watchdog looks. A call that it meets before its deadline is waited for exactly, so a look per budget is
// as good as many; one that is met later was up to a look and `grace_ns` too long.
struct WatchdogConfig {
  std::int64_t look_every_ns = 100'000;  // 0 = spin: a core of its own, and the tick's line in its cache all the time
  std::int64_t idle_after_ns = 100'000'000;     // no call for so long: nobody ticks a law ...
  std::int64_t idle_look_every_ns = 1'000'000;  // ... and this is often enough, also for the first call
  std::int64_t grace_ns = 300'000;              // of CPU time for a call that is met too late: about a budget
  std::int64_t notice_ns = 25'000;              // of CPU time once a call has taken its notice
  std::int64_t most_wall_ns = 100'000'000;      // past its deadline a call ends, whatever CPU time it had
  std::int64_t (*cpu_ns)(clockid_t thread) noexcept = &cpu_time_ns;  // a test puts the wall clock here
};

inline constexpr std::size_t kMaxWatched = 4;
enum class Ask : std::uint8_t;  // core.hpp

// The body of a thread on another core than the Cells', as urgent as they are: while it does not run, nothing ends an
// endless law. A call is charged from the look that meets it on with the CPU time of its thread: one whose thread the
// machine took away past the deadline may go on, one that waits in the kernel ends after `most_wall_ns`. What a call
// did before that look counts as CPU time, unless the Watchdog was late itself. A hypervisor takes the processor
// without a word, and the thread's clock runs on; so a call that has used up its budget is given notice first: a signal
// that returns, which shows that the thread runs. A law that was only held up is over long before `notice_ns` more.
// Contract: off the tick · watch() and forget() from any thread · outlives the Cells it watches
class Watchdog {
 public:
  explicit Watchdog(const WatchdogConfig& config = {}) : config_(config) {}
  Watchdog(const Watchdog&) = delete;
  Watchdog& operator=(const Watchdog&) = delete;

  // Until the Cell is destroyed.
  Result<> watch(Cell& cell);

  void run(const std::atomic<bool>& stop) noexcept;

  // One look. Returns how long the next one may wait [ns].
  std::int64_t look(std::int64_t now_ns) noexcept;

  std::uint64_t signals_sent() const { return sent_.load(std::memory_order_relaxed); }

 private:
  friend class Cell;
  void forget(const Core& core);

  struct Watched {
    Core* core = nullptr;
    const Vault* vault = nullptr;  // where the core lies
    std::int64_t deadline_ns = 0;  // at the last look
    std::uint64_t met = 0;         // the call the next three are about
    std::int64_t met_ns = 0;       // the look that met it
    std::int64_t met_cpu_ns = -1;  // its thread's CPU time then
    std::int64_t left_ns = 0;      // of CPU time, from then on
    bool noticed = false;          // it took its notice: what is left is the last
    std::uint64_t told = 0;        // the call that was sent the last signal, ...
    Ask asked{};                   // ... for what, ...
    std::int64_t again_ns = 0;     // ... and when it is sent again
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
