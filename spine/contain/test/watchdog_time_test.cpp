// SPDX-License-Identifier: Apache-2.0
// Whose time a call is charged for: its own, not what the machine gave to others.
#include <sched.h>
#include <signal.h>
#include <sys/syscall.h>

#include <atomic>
#include <ctime>
#include <ostream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"
#include "spine/contain/watchdog.hpp"
#include "spine/core/test/emulation_rig.hpp"
#include "spine/core/time.hpp"

namespace lithe::contain {
namespace {

using wire::LawFaultKind;

// A look of the Watchdog: when it is, and how much CPU time the law's thread has used by then. Both are arguments, so
// no test here depends on what else the machine does.
struct Look {
  std::int64_t now_ns;
  std::int64_t cpu_ns;
};
std::atomic<std::int64_t> thread_cpu_ns;  // what the Watchdog reads: WatchdogConfig::cpu_ns has no context

WatchdogConfig with_a_set_clock() {
  WatchdogConfig config;
  config.cpu_ns = [](clockid_t) noexcept { return thread_cpu_ns.load(); };
  return config;
}

// Makes the looks that a law asks for. In a thread of its own: a law that is broken off inside a look would leave the
// Watchdog's mutex locked.
class Looker {
 public:
  explicit Looker(Watchdog& dog) : dog_(dog), thread_([this] { run(); }) {}
  ~Looker() {
    stop_.store(true);
    thread_.join();
  }
  // From the law. What the look sent has been handled when this returns: a signal is handled on the way back from a
  // call of the kernel.
  void look(const Look& look) {
    while (done_.load() != asked_.load()) yield();
    look_ = look;
    const int number = asked_.load() + 1;
    asked_.store(number);
    while (done_.load() != number) yield();
    yield();
  }

 private:
  static void yield() { bad::call_kernel(SYS_sched_yield); }
  void run() {
    for (; !stop_.load(); std::this_thread::yield()) {
      const int number = asked_.load();
      if (done_.load() == number) continue;
      thread_cpu_ns.store(look_.cpu_ns);
      dog_.look(look_.now_ns);
      done_.store(number);
    }
  }
  Watchdog& dog_;
  Look look_{};
  std::atomic<int> asked_{0}, done_{0};
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

// A law that lives through these looks and then ends by itself; its deadline is at 200 us.
struct Looks {
  Looker* looker;
  std::vector<Look> looks;
};
void live_through(void* context) {
  auto* law = static_cast<Looks*>(context);
  for (const Look& look : law->looks) law->looker->look(look);
}

// How a law with these looks ended, and how many signals it got.
struct Ending {
  LawFaultKind kind;
  std::uint64_t signals;
  bool operator==(const Ending&) const = default;
};
std::ostream& operator<<(std::ostream& out, const Ending& ending) {
  return out << "fault " << static_cast<int>(ending.kind) << " after " << ending.signals << " signals";
}
Ending ending_of(const WatchdogConfig& config, std::vector<Look> looks) {
  Watchdog dog(config);
  FaultBarrier barrier = open_barrier();
  const Result<> watched = dog.watch(barrier);
  if (!watched) ADD_FAILURE() << watched.message();
  Failure failure;
  {
    Looker looker(dog);
    Looks law{&looker, std::move(looks)};
    failure = barrier.run(kBudgetNs, live_through, &law);
  }  // waits for the look that broke the law off: it counts its signal after the law has got it
  return {failure.kind, dog.signals_sent()};
}

constexpr std::int64_t kUs = 1'000;
constexpr std::int64_t kNoticeNs = WatchdogConfig{}.notice_ns;
constexpr std::int64_t kGraceNs = WatchdogConfig{}.grace_ns;
const Look kMet{100 * kUs, 0};  // on time, with half of the budget left

TEST_F(WatchdogTest, ACallIsNotChargedForTheTimeItsThreadWasAway) {
  const std::vector<Look> away{kMet, {10 * kNsPerMs, 50 * kUs}, {20 * kNsPerMs, 99 * kUs}};
  EXPECT_EQ(ending_of(with_a_set_clock(), away), (Ending{LawFaultKind::none, 0}));
  std::vector<Look> works = away;
  works.insert(works.end(), {{20 * kNsPerMs + kUs, 100 * kUs},
                             {20 * kNsPerMs + 2 * kUs, 101 * kUs},
                             {20 * kNsPerMs + 30 * kUs, 101 * kUs + kNoticeNs}});
  EXPECT_EQ(ending_of(with_a_set_clock(), works), (Ending{LawFaultKind::overran, 2})) << "a notice, and the end";
}

TEST_F(WatchdogTest, ACallThatIsSeenLateMayUseTheGrace) {
  const Look met{10 * kNsPerMs, 0};  // this look is late itself
  std::vector<Look> looks{met, {11 * kNsPerMs, kGraceNs - 1}};
  EXPECT_EQ(ending_of(with_a_set_clock(), looks), (Ending{LawFaultKind::none, 0}));
  looks.push_back({11 * kNsPerMs + kUs, kGraceNs});
  EXPECT_EQ(ending_of(with_a_set_clock(), looks), (Ending{LawFaultKind::none, 1})) << "the notice";
  looks.insert(looks.end(), {{11 * kNsPerMs + 2 * kUs, kGraceNs}, {12 * kNsPerMs, kGraceNs + kNoticeNs}});
  EXPECT_EQ(ending_of(with_a_set_clock(), looks), (Ending{LawFaultKind::overran, 2}));
}

// A thread's clock that runs on while a hypervisor has taken the processor: 5 ms pass, and the law has hardly any work
// left.
std::vector<Look> held_up(std::int64_t left_ns) {
  constexpr std::int64_t kBackNs = 5 * kNsPerMs;
  return {kMet, {kBackNs, kBackNs}, {kBackNs + kUs, kBackNs + kUs}, {kBackNs + kUs + left_ns, kBackNs + kUs + left_ns}};
}

TEST_F(WatchdogTest, ACallThatWasHeldUpTakesItsNoticeAndEndsByItself) {
  EXPECT_EQ(ending_of(with_a_set_clock(), held_up(kNoticeNs - 1)), (Ending{LawFaultKind::none, 1}));
}

TEST_F(WatchdogTest, ACallThatWasHeldUpAndHasWorkLeftIsBrokenOff) {
  EXPECT_EQ(ending_of(with_a_set_clock(), held_up(kNoticeNs)), (Ending{LawFaultKind::overran, 2}));
}

// The broken twin gives none: its hard limit is the deadline.
TEST_F(WatchdogTest, WithoutNoticeACallThatWasHeldUpIsBrokenOff) {
  WatchdogConfig hasty = with_a_set_clock();
  hasty.most_wall_ns = 0;
  EXPECT_EQ(ending_of(hasty, held_up(0)), (Ending{LawFaultKind::overran, 1}));
}

// --- with the clocks of this machine ---

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
  config.grace_ns = 20 * kNsPerMs;      // should it come too late itself
  config.most_wall_ns = 100 * kNsPerS;  // twelve threads, and whatever else this machine does
  Guarded guarded(config);              // on the other cores, too
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
