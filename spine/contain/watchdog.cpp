// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/watchdog.hpp"

#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <ctime>
#include <string>

#include "spine/contain/core.hpp"
#include "spine/core/time.hpp"

namespace lithe::contain {
namespace {

// A signal that could not be queued or was not handled in time is sent again after this long.
constexpr std::int64_t kAgainAfterNs = kNsPerMs;
// A look that is late by this many intervals does not charge the call: the call's thread may have been preempted too.
constexpr std::int64_t kLooksMissed = 3;
constexpr std::int64_t kShortestLookNs = 100'000;

}  // namespace

std::int64_t cpu_time_ns(clockid_t thread) noexcept {
  timespec spent{};
  return clock_gettime(thread, &spent) == 0 ? spent.tv_sec * kNsPerS + spent.tv_nsec : -1;
}

siginfo_t watch_message(std::uint64_t serial, Ask ask) noexcept {
  siginfo_t message{};
  message.si_signo = watch_signal();
  message.si_code = SI_QUEUE;
  message.si_pid = getpid();
  message.si_uid = getuid();
  message.si_value.sival_ptr = reinterpret_cast<void*>(static_cast<std::uintptr_t>(serial << 1 | (ask == Ask::end)));
  return message;
}

// Sends a signal with a value to one thread: neither kill() nor pthread_kill() can do both.
bool send_watch_signal(pid_t thread, std::uint64_t serial, Ask ask) noexcept {
  siginfo_t message = watch_message(serial, ask);
  return syscall(SYS_rt_tgsigqueueinfo, message.si_pid, thread, message.si_signo, &message) == 0;
}

Result<> Watchdog::watch(FaultBarrier& barrier) {
  const std::lock_guard lock(mutex_);
  for (Watched& place : watched_) {
    if (place.core != nullptr) continue;
    place.core = barrier.core_.get();
    place.protected_memory = place.core->protected_memory;
    barrier.core_->watchdog = this;
    return done();
  }
  return Error{"the watchdog watches " + std::to_string(watched_.size()) + " threads already (kMaxWatched)"};
}

void Watchdog::forget(const Core& core) {
  const std::lock_guard lock(mutex_);
  for (Watched& place : watched_)
    if (place.core == &core) place = {};
}

void Watchdog::run(const std::atomic<bool>& stop) noexcept {
  prctl(PR_SET_TIMERSLACK, 1ul);  // otherwise the kernel adds 50 us to every sleep
  last_call_ns_ = monotonic_ns();
  while (!stop.load(std::memory_order_relaxed)) {  // relaxed: only the stop flag is passed
    const std::int64_t wait_ns = look(monotonic_ns());
    if (wait_ns <= 0) {
      spin_pause();
      continue;
    }
    const timespec wait{wait_ns / kNsPerS, wait_ns % kNsPerS};
    nanosleep(&wait, nullptr);
  }
}

std::int64_t Watchdog::look(std::int64_t now_ns) noexcept {
  const std::lock_guard lock(mutex_);
  const bool on_time = now_ns - last_look_ns_ <= kLooksMissed * std::max(config_.look_every_ns, kShortestLookNs);
  last_look_ns_ = now_ns;
  std::int64_t wait_ns = config_.look_every_ns;
  for (Watched& watched : watched_)
    if (watched.core != nullptr) wait_ns = std::min(wait_ns, look_at(watched, now_ns, on_time));
  const bool idle = wait_ns == config_.look_every_ns && now_ns - last_call_ns_ > config_.idle_after_ns;
  return idle ? config_.idle_look_every_ns : wait_ns;
}

// From now on the call may use `left_ns` more.
void Watchdog::open_account(Watched& watched, std::int64_t now_ns, std::int64_t left_ns) const noexcept {
  watched.met_ns = now_ns;
  watched.met_cpu_ns = config_.cpu_ns(watched.core->cpu_clock);
  watched.left_ns = left_ns;
}

// CPU time that the call may still use [ns]. Its thread's clock was read at the first look, and is read again past the
// deadline, `wall_ns` from now.
std::int64_t Watchdog::left_of(const Watched& watched, std::int64_t wall_ns, std::int64_t now_ns) const noexcept {
  if (wall_ns > 0) return wall_ns;
  const std::int64_t cpu_ns = config_.cpu_ns(watched.core->cpu_clock);
  const bool known = cpu_ns >= 0 && watched.met_cpu_ns >= 0;
  const std::int64_t spent_ns = known ? cpu_ns - watched.met_cpu_ns : now_ns - watched.met_ns;
  return std::min(watched.left_ns - spent_ns, wall_ns + config_.most_wall_ns);
}

void Watchdog::tell(Watched& watched, std::uint64_t call, Ask ask, std::int64_t now_ns) noexcept {
  if (call == watched.told && ask == watched.asked && now_ns < watched.again_ns) return;
  if (!send_watch_signal(watched.core->thread, call, ask)) return;
  watched.told = call;
  watched.asked = ask;
  watched.again_ns = now_ns + kAgainAfterNs;
  sent_.fetch_add(1, std::memory_order_relaxed);
}

// Time until the next look at this call [ns].
std::int64_t Watchdog::look_at(Watched& watched, std::int64_t now_ns, bool on_time) noexcept {
  if (watched.protected_memory != nullptr)
    watched.protected_memory->open_for_this_thread();  // the protected memory may be made after this thread
  Core& core = *watched.core;
  // acquire: partner of the release in FaultBarrier::run(). A later call has a later deadline, so mixing the two values
  // only delays the end.
  const std::uint64_t call = core.call.load(std::memory_order_acquire);
  const std::int64_t deadline_ns = core.deadline_ns.load(std::memory_order_relaxed);
  if (deadline_ns != watched.deadline_ns) {  // not `call`: a look rarely comes while a law runs
    watched.deadline_ns = deadline_ns;
    last_call_ns_ = now_ns;
  }
  if (call == 0) return config_.look_every_ns;
  const std::int64_t wall_ns = deadline_ns - now_ns;
  if (call != watched.met) {
    watched.met = call;
    watched.noticed = false;
    // Seen late: this thread or the call's thread was not running; which one is unknown.
    open_account(watched, now_ns, on_time && wall_ns > 0 ? wall_ns : std::max(wall_ns, config_.grace_ns));
  }
  const std::int64_t left_ns = left_of(watched, wall_ns, now_ns);
  if (left_ns > 0) return std::min(left_ns, config_.look_every_ns);
  if (watched.noticed || wall_ns + config_.most_wall_ns <= 0) {
    tell(watched, call, Ask::end, now_ns);
    return config_.look_every_ns;
  }
  watched.noticed = core.noticed.load(std::memory_order_relaxed) == call;
  if (watched.noticed)
    open_account(watched, now_ns, config_.notice_ns);
  else
    tell(watched, call, Ask::notice, now_ns);
  return std::min(config_.notice_ns, config_.look_every_ns);
}

}  // namespace lithe::contain
