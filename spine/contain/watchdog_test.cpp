// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/watchdog.hpp"

#include <signal.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <vector>

#include "spine/contain/core.hpp"
#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"
#include "spine/core/time.hpp"

namespace lithe::contain {
namespace {

using wire::LawFaultKind;

TEST_F(WatchdogTest, AnEndlessLoopIsBrokenOffAgainAndAgain) {
  Guarded guarded;
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  int runs = 0;
  for (int i = 0; i < 200; ++i) {
    const std::int64_t from_ns = monotonic_ns();
    ASSERT_EQ(barrier.run(deadline(), bad::loop_forever, nullptr).kind, LawFaultKind::overran) << i;
    ASSERT_GE(monotonic_ns() - from_ns, kBudgetNs) << "broken off before its deadline";
    ASSERT_FALSE(barrier.run(kNoDeadline, bad::count, &runs));
  }
  EXPECT_EQ(runs, 200);
}

TEST_F(WatchdogTest, ASpinningWatchdogDoesTheSame) {
  WatchdogConfig spinning;
  spinning.look_every_ns = 0;
  Guarded guarded(spinning);
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  for (int i = 0; i < 20; ++i)
    ASSERT_EQ(barrier.run(deadline(), bad::loop_forever, nullptr).kind, LawFaultKind::overran) << i;
}

TEST_F(WatchdogTest, TheFirstCallAfterALongPauseIsWatchedToo) {
  WatchdogConfig config;
  config.idle_after_ns = 1'000'000;
  Guarded guarded(config);
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  for (int i = 0; i < 3; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    ASSERT_EQ(barrier.run(deadline(), bad::loop_forever, nullptr).kind, LawFaultKind::overran);
  }
}

TEST_F(WatchdogTest, TheTroubleNamesTheLoop) {
  Guarded guarded;
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  const Failure failure = barrier.run(deadline(), bad::loop_forever, nullptr);
  const auto loop = reinterpret_cast<std::uintptr_t>(&bad::loop_forever);
  EXPECT_GE(failure.pc, loop);
  EXPECT_LT(failure.pc, loop + 256);
}

TEST_F(WatchdogTest, SeveralThreadsAreWatchedAndNoMoreThanItHasPlacesFor) {
  Guarded guarded;
  std::atomic<int> watched{0}, refused{0}, broken{0};
  std::vector<std::thread> threads;
  for (std::size_t i = 0; i <= kMaxWatched; ++i) {
    threads.emplace_back([&] {
      FaultBarrier barrier = open_barrier();
      const bool has_place = static_cast<bool>(guarded.dog.watch(barrier));
      ++(has_place ? watched : refused);
      while (watched + refused <= static_cast<int>(kMaxWatched)) std::this_thread::yield();
      if (has_place && barrier.run(deadline(), bad::loop_forever, nullptr).kind == LawFaultKind::overran) ++broken;
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(watched, static_cast<int>(kMaxWatched));
  EXPECT_EQ(refused, 1);
  EXPECT_EQ(broken, static_cast<int>(kMaxWatched));
  FaultBarrier barrier = open_barrier();
  EXPECT_TRUE(guarded.dog.watch(barrier)) << "places of threads that are gone are free again";
}

TEST_F(WatchdogTest, ProtectedMemoryYoungerThanTheWatchdogsThreadIsOpenToIt) {
  Guarded guarded;
  const Result<std::unique_ptr<ProtectedMemory>> protected_memory = ProtectedMemory::make(1 << 14);
  ASSERT_TRUE(protected_memory) << protected_memory.message();
  FaultBarrier barrier = open_barrier(protected_memory->get());
  watch(guarded.dog, barrier);
  for (int i = 0; i < 20; ++i)
    ASSERT_EQ(barrier.run(deadline(), bad::loop_forever, nullptr).kind, LawFaultKind::overran);
}

// What the two threads share without a signal: for ThreadSanitizer too, which holds signals back.
TEST(Watchdog, AWatchdogLooksOnWhileCallsBeginAndEndAndBarriersComeAndGo) {
  WatchdogConfig spinning;
  spinning.look_every_ns = 0;
  Guarded guarded(spinning);
  int runs = 0;
  for (int barriers = 0; barriers < 20; ++barriers) {
    FaultBarrier barrier = open_barrier();
    ASSERT_TRUE(guarded.dog.watch(barrier));
    for (int i = 0; i < 1000; ++i) ASSERT_FALSE(barrier.run(monotonic_ns() + kNsPerS, bad::count, &runs));
  }
  EXPECT_EQ(runs, 20'000);
  EXPECT_EQ(guarded.dog.signals_sent(), 0u);
}

// --- a signal that comes too late ---

// A law that meets, while it runs, the signal for some call: what happens when a Watchdog was preempted between its
// look and its signal.
struct Meeting {
  explicit Meeting(std::uint64_t serial, Ask ask = Ask::end) : message(watch_message(serial, ask)) {}
  siginfo_t message;
  pid_t thread = static_cast<pid_t>(syscall(SYS_gettid));
  long result = -1;
};
void meet(void* context) {
  auto* meeting = static_cast<Meeting*>(context);
  meeting->result = bad::call_kernel(SYS_rt_tgsigqueueinfo, meeting->message.si_pid, meeting->thread,
                                     meeting->message.si_signo, reinterpret_cast<long>(&meeting->message));
}

TEST_F(WatchdogTest, ASignalForAnotherCallBreaksNothingOff) {
  FaultBarrier barrier = open_barrier();
  for (std::uint64_t call = 1; call <= 100; ++call) {
    Meeting before(call - 1), after(call);
    ASSERT_FALSE(barrier.run(kNoDeadline, meet, &before)) << call;
    ASSERT_EQ(before.result, 0);
    meet(&after);  // its own, but it is over
  }
  EXPECT_EQ(barrier.late_signals(), 200u);
  Meeting own(101);
  EXPECT_EQ(barrier.run(kNoDeadline, meet, &own).kind, LawFaultKind::overran);
}

TEST_F(WatchdogTest, ANoticeIsTakenAndBreaksNothingOff) {
  FaultBarrier barrier = open_barrier();
  for (std::uint64_t call = 1; call <= 100; ++call) {
    Meeting notice(call, Ask::notice);
    ASSERT_FALSE(barrier.run(kNoDeadline, meet, &notice)) << call;
    ASSERT_EQ(notice.result, 0);
  }
  EXPECT_EQ(barrier.late_signals(), 0u);
}

// The broken twin: without the comparison the innocent call is cut off.
struct AnyCall {
  static bool is_meant(std::uint64_t, std::uint64_t running) { return running != 0; }
};

TEST_F(WatchdogTest, WithoutTheSerialNumberAnInnocentCallIsBrokenOff) {
  FaultBarrier barrier = open_barrier();
  struct sigaction action{}, proper{};
  action.sa_sigaction = on_watch_signal<AnyCall>;
  action.sa_flags = SA_ONSTACK | SA_SIGINFO;
  sigfillset(&action.sa_mask);
  ASSERT_EQ(sigaction(watch_signal(), &action, &proper), 0);
  Meeting before(0);
  EXPECT_EQ(barrier.run(kNoDeadline, meet, &before).kind, LawFaultKind::overran);
  sigaction(watch_signal(), &proper, nullptr);
  EXPECT_FALSE(barrier.run(kNoDeadline, meet, &before));
}

TEST_F(WatchdogTest, SomebodyElsesSignalBreaksNothingOff) {
  FaultBarrier barrier = open_barrier();
  Meeting own(1);
  own.message.si_code = SI_TKILL;  // the right number, but not queued by a Watchdog
  EXPECT_FALSE(barrier.run(kNoDeadline, meet, &own));
  EXPECT_EQ(own.result, 0);
  EXPECT_EQ(barrier.late_signals(), 1u);
}

// --- two faults at once ---

// Dies at its deadline, when the Watchdog's signal comes, too.
void die_at(void* at_ns) {
  while (monotonic_ns() < *static_cast<std::int64_t*>(at_ns)) {
  }
  bad::overflow_stack(nullptr);
}

TEST_F(WatchdogTest, AFaultAtTheDeadlineIsOneTrouble) {
  WatchdogConfig spinning;
  spinning.look_every_ns = 0;
  Guarded guarded(spinning);
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  int faults = 0, overruns = 0, runs = 0;
  for (int i = 0; i < 1000; ++i) {
    std::int64_t at_ns = monotonic_ns() + 20'000;
    const Failure failure = barrier.run(at_ns - 2'000 + i % 20 * 400, die_at, &at_ns);
    faults += failure.kind == LawFaultKind::bad_access ? 1 : 0;
    overruns += failure.kind == LawFaultKind::overran ? 1 : 0;
    ASSERT_FALSE(barrier.run(kNoDeadline, bad::count, &runs));
  }
  EXPECT_EQ(faults + overruns, 1000);
  EXPECT_EQ(runs, 1000);
}

TEST_F(WatchdogTest, CrashesUnderAHailOfLateSignalsAreContained) {
  FaultBarrier barrier = open_barrier();
  std::atomic<bool> stop{false};
  const auto target = static_cast<pid_t>(syscall(SYS_gettid));
  std::thread hail([&] {
    while (!stop.load()) {
      send_watch_signal(target, UINT64_MAX, Ask::end);
      std::this_thread::sleep_for(std::chrono::microseconds(1));
    }
  });
  int runs = 0, crashes = 0;
  // On a busy machine the hail begins late: until it has begun, or for 10 s.
  const std::int64_t give_up_ns = monotonic_ns() + 10'000'000'000;
  for (; crashes < 2000 || (barrier.late_signals() == 0 && monotonic_ns() < give_up_ns); ++crashes) {
    const bad::Case& each = bad::kCrashes[static_cast<std::size_t>(crashes) % bad::kCrashes.size()];
    ASSERT_EQ(barrier.run(kNoDeadline, each.call, nullptr).kind, each.kind) << each.name;
    ASSERT_FALSE(barrier.run(kNoDeadline, bad::count, &runs));
  }
  stop.store(true);
  hail.join();
  EXPECT_EQ(runs, crashes);
  EXPECT_GT(barrier.late_signals(), 0u);
}

}  // namespace
}  // namespace lithe::contain
