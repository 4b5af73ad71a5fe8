// SPDX-License-Identifier: Apache-2.0
// Whose time a call is charged for: its own, not what the machine gave to others.
#include <sched.h>
#include <signal.h>
#include <sys/syscall.h>

#include <atomic>
#include <ctime>
#include <string>
#include <thread>
#include <vector>

#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"
#include "spine/contain/watchdog.hpp"
#include "spine/core/test/emulation_rig.hpp"
#include "spine/core/time.hpp"

namespace lithe::contain {
namespace {

using wire::LawFaultKind;

// A law that is away for a while, as one whose thread the machine took away; then it works.
struct Away {
  timespec away;
  std::int64_t work_ns;
};
void be_away_then_work(void* context) {
  const auto* law = static_cast<const Away*>(context);
  bad::call_kernel(SYS_nanosleep, reinterpret_cast<long>(&law->away));
  const std::int64_t from_ns = cpu_time_ns(CLOCK_THREAD_CPUTIME_ID);
  while (cpu_time_ns(CLOCK_THREAD_CPUTIME_ID) - from_ns < law->work_ns) {
  }
}
constexpr std::int64_t kForEver = INT64_MAX / 2;

// A law whose thread takes no signal for 5 ms: as nothing reaches a processor that a hypervisor has taken.
struct HeldUp {
  std::uint64_t all = ~std::uint64_t{0};
  std::uint64_t before = 0;
  timespec away{0, 5 * kNsPerMs};
};
void be_held_up(void* context) {
  auto* law = static_cast<HeldUp*>(context);
  constexpr long kBytes = sizeof law->all;
  bad::call_kernel(SYS_rt_sigprocmask, SIG_BLOCK, reinterpret_cast<long>(&law->all),
                   reinterpret_cast<long>(&law->before), kBytes);
  bad::call_kernel(SYS_nanosleep, reinterpret_cast<long>(&law->away));
  bad::call_kernel(SYS_rt_sigprocmask, SIG_SETMASK, reinterpret_cast<long>(&law->before), 0, kBytes);
}

TEST_F(WatchdogTest, ACallIsNotChargedForTheTimeItsThreadWasAway) {
  Guarded guarded;
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  Away away{{0, 10 * kNsPerMs}, 0};
  // On a busy machine the dog itself may come so late that nothing is left of the budget it met.
  int broken_off = 0;
  for (int i = 0; i < 20; ++i) broken_off += barrier.run(deadline(), be_away_then_work, &away) ? 1 : 0;
  for (int i = 0; i < 5; ++i) broken_off += barrier.run(monotonic_ns() - 1, be_away_then_work, &away) ? 1 : 0;
  EXPECT_LT(broken_off, 13) << "of 25, the last five met past their deadline only; by the wall clock it is all of them";
  away.work_ns = kForEver;
  const std::int64_t from_ns = monotonic_ns();
  EXPECT_EQ(barrier.run(deadline(), be_away_then_work, &away).kind, LawFaultKind::overran);
  EXPECT_GE(monotonic_ns() - from_ns, away.away.tv_nsec);
}

// A thread's clock that runs on while the thread is away: so it is, read from outside, when a hypervisor has taken the
// processor.
WatchdogConfig by_the_wall_clock() {
  WatchdogConfig wall;
  wall.cpu_ns = [](clockid_t) noexcept { return monotonic_ns(); };
  return wall;
}

// The broken twin of the one before: what has work left when it comes back is broken off.
TEST_F(WatchdogTest, ByTheWallClockACallWithWorkLeftIsBrokenOff) {
  Guarded guarded(by_the_wall_clock());
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  Away away{{0, 10 * kNsPerMs}, 10 * kNsPerMs};
  for (int i = 0; i < 5; ++i)
    EXPECT_EQ(barrier.run(deadline(), be_away_then_work, &away).kind, LawFaultKind::overran) << i;
}

// Held up with hardly any work left, as a law is that a hypervisor stopped half-way through its 100 ns.
int broken_off_when_held_up(const WatchdogConfig& config) {
  Guarded guarded(config);
  const Result<> installed = install_handlers();
  Result<FaultBarrier> barrier = FaultBarrier::open();
  if (!installed || !barrier || !guarded.dog.watch(*barrier)) return -1;
  HeldUp law;
  int broken_off = 0;
  for (int i = 0; i < 20; ++i) broken_off += barrier->run(monotonic_ns() + kBudgetNs, be_held_up, &law) ? 1 : 0;
  return broken_off;
}

TEST_F(WatchdogTest, ACallThatWasHeldUpTakesItsNoticeAndEndsByItself) {
  const std::string slow = test::why_signals_are_slow(WatchdogConfig{}.notice_ns);
  if (!slow.empty()) GTEST_SKIP() << slow;
  EXPECT_LT(broken_off_when_held_up(by_the_wall_clock()), 5) << "some, where a notice was all that ran for a while";
}

// The broken twin gives none: its hard limit is the deadline.
TEST_F(WatchdogTest, WithoutNoticeACallThatWasHeldUpIsBrokenOff) {
  WatchdogConfig hasty = by_the_wall_clock();
  hasty.most_wall_ns = 0;
  EXPECT_GT(broken_off_when_held_up(hasty), 5) << "all, where the dog itself is not held up";
}

TEST_F(WatchdogTest, WithoutAThreadsClockTheWallClockCounts) {
  WatchdogConfig blind;
  blind.cpu_ns = [](clockid_t) noexcept { return std::int64_t{-1}; };
  Guarded guarded(blind);
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  EXPECT_EQ(barrier.run(deadline(), bad::loop_forever, nullptr).kind, LawFaultKind::overran);
}

TEST_F(WatchdogTest, ACallThatNeverComesBackFromTheKernelEndsAtTheHardLimit) {
  WatchdogConfig config;
  config.most_wall_ns = 20 * kNsPerMs;
  Guarded guarded(config);
  FaultBarrier barrier = open_barrier();
  watch(guarded.dog, barrier);
  Away away{{3600, 0}, 0};
  const std::int64_t from_ns = monotonic_ns();
  EXPECT_EQ(barrier.run(deadline(), be_away_then_work, &away).kind, LawFaultKind::overran);
  EXPECT_GE(monotonic_ns() - from_ns, config.most_wall_ns);
}

// The real thing: twelve threads that want the same core. Each call works for a fifth of its budget.
TEST_F(WatchdogTest, ACallWhoseThreadIsPreemptedAllTheTimeIsNotBrokenOff) {
  const std::string slow = test::why_signals_are_slow(WatchdogConfig{}.notice_ns);
  if (!slow.empty()) GTEST_SKIP() << slow;
  cpu_set_t allowed, one;
  ASSERT_EQ(sched_getaffinity(0, sizeof allowed, &allowed), 0);
  if (CPU_COUNT(&allowed) < 2) GTEST_SKIP() << "one core: the Watchdog would stand in the same queue";
  int last = CPU_SETSIZE - 1;
  while (!CPU_ISSET(last, &allowed)) --last;
  CPU_ZERO(&one);
  CPU_SET(last, &one);
  WatchdogConfig config;
  config.grace_ns = 20 * kNsPerMs;  // should it come too late itself
  Guarded guarded(config);          // on the other cores, too
  std::atomic<bool> stop{false};
  std::vector<std::thread> crowd;
  constexpr int kLate = 10;
  int late = 0, broken_off = 0;
  std::thread victim([&] {
    sched_setaffinity(0, sizeof one, &one);
    FaultBarrier barrier = open_barrier();
    watch(guarded.dog, barrier);
    Away law{{0, 0}, 5 * kNsPerMs};
    for (int i = 0; i < 400 && late < kLate; ++i) {
      const std::int64_t from_ns = monotonic_ns();
      broken_off += barrier.run(from_ns + 5 * law.work_ns, be_away_then_work, &law) ? 1 : 0;
      late += monotonic_ns() - from_ns > 5 * law.work_ns ? 1 : 0;
    }
  });
  for (int i = 0; i < 12; ++i) {
    crowd.emplace_back([&] {
      sched_setaffinity(0, sizeof one, &one);
      while (!stop.load()) {
      }
    });
  }
  victim.join();
  stop.store(true);
  for (std::thread& each : crowd) each.join();
  ASSERT_EQ(late, kLate) << "twelve beside it, and hardly anything was preempted past its deadline";
  EXPECT_LT(broken_off, late / 2) << "some, where the dog came late itself; by the wall clock it is all of them";
}

}  // namespace
}  // namespace lithe::contain
