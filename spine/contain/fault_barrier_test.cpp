// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/fault_barrier.hpp"

#include <signal.h>
#include <unistd.h>

#include <cfenv>
#include <chrono>
#include <cstring>
#include <limits>
#include <string>
#include <thread>

#include "spine/contain/environment.hpp"
#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"
#include "spine/core/serialise.hpp"

namespace lithe::contain {
namespace {

using wire::LawFaultKind;

class FaultBarrierTest : public testing::Test {
 protected:
  // The thread goes on: a law that is in order runs, and its stack and handlers are whole.
  static void expect_goes_on(FaultBarrier& barrier) {
    int runs = 0;
    EXPECT_EQ(barrier.run(kNoDeadline, bad::count, &runs).kind, LawFaultKind::none);
    EXPECT_EQ(runs, 1);
  }
};

TEST_F(FaultBarrierTest, EveryCrashIsContainedAndTheThreadGoesOn) {
  FaultBarrier barrier = open_barrier();
  for (const bad::Case& each : bad::kCrashes) {
    SCOPED_TRACE(each.name);
    EXPECT_EQ(barrier.run(kNoDeadline, each.call, nullptr).kind, each.kind);
    expect_goes_on(barrier);
  }
  void* page = bad::page_without_file();
  ASSERT_NE(page, MAP_FAILED);
  EXPECT_EQ(barrier.run(kNoDeadline, bad::leave_file, page).kind, LawFaultKind::bus_error);
  expect_goes_on(barrier);
  munmap(page, 4096);
}

TEST_F(FaultBarrierTest, AThousandCrashesInTurnLeaveNothingBehind) {
  FaultBarrier barrier = open_barrier();
  int runs = 0;
  for (std::size_t i = 0; i < 1000; ++i) {
    const bad::Case& each = bad::kCrashes[i % bad::kCrashes.size()];
    ASSERT_EQ(barrier.run(kNoDeadline, each.call, nullptr).kind, each.kind) << each.name << " at " << i;
    ASSERT_FALSE(barrier.run(kNoDeadline, bad::count, &runs));
  }
  EXPECT_EQ(runs, 1000);
}

TEST_F(FaultBarrierTest, AnotherThreadHasItsOwnBarrier) {
  FaultBarrier barrier = open_barrier();
  std::thread other([] {
    FaultBarrier own = open_barrier();
    for (int i = 0; i < 100; ++i)
      EXPECT_EQ(own.run(kNoDeadline, bad::overflow_stack, nullptr).kind, LawFaultKind::bad_access);
  });
  for (int i = 0; i < 100; ++i)
    EXPECT_EQ(barrier.run(kNoDeadline, bad::overflow_stack, nullptr).kind, LawFaultKind::bad_access);
  other.join();
}

TEST_F(FaultBarrierTest, AThreadHasOneBarrierAtATimeAndMayOpenAnotherAfterIt) {
  {
    FaultBarrier barrier = open_barrier();
    EXPECT_FALSE(FaultBarrier::open());
  }
  FaultBarrier again = open_barrier();
  EXPECT_TRUE(again.run(kNoDeadline, bad::write_null, nullptr));
}

TEST_F(FaultBarrierTest, TroubleSaysWhereAndWhatWasTouched) {
  FaultBarrier barrier = open_barrier();
  const Failure failure = barrier.run(kNoDeadline, bad::write_null, nullptr);
  EXPECT_EQ(failure.address, 0x10u);
  const auto store = reinterpret_cast<std::uintptr_t>(&bad::store_at);
  EXPECT_GE(failure.pc, store);
  EXPECT_LT(failure.pc, store + 256);
}

TEST_F(FaultBarrierTest, AGoodCallsReportIsEmptyAlsoAfterACrash) {
  FaultBarrier barrier = open_barrier();
  EXPECT_TRUE(barrier.run(kNoDeadline, bad::write_null, nullptr));
  const Failure none = barrier.run(kNoDeadline, bad::nothing, nullptr);
  EXPECT_EQ(none.kind, LawFaultKind::none);
  EXPECT_EQ(none.pc, 0u);
  EXPECT_EQ(none.address, 0u);
}

TEST_F(FaultBarrierTest, HandlersRunOnAStackBehindAGuardPage) {
  FaultBarrier barrier = open_barrier();
  stack_t stack{};
  ASSERT_EQ(sigaltstack(nullptr, &stack), 0);
  EXPECT_EQ(stack.ss_flags, 0);
  EXPECT_GE(stack.ss_size, std::size_t{64} << 10);
  const auto below = reinterpret_cast<std::uintptr_t>(stack.ss_sp) - 1;
  const Failure failure = barrier.run(
      kNoDeadline, [](void* at) { bad::store_at(*static_cast<std::uintptr_t*>(at) & ~std::uintptr_t{15}); },
      const_cast<std::uintptr_t*>(&below));
  EXPECT_EQ(failure.kind, LawFaultKind::bad_access);
}

TEST_F(FaultBarrierTest, AMaskALawDiesWithIsPutRight) {
  FaultBarrier barrier = open_barrier();
  sigset_t before, after;
  pthread_sigmask(SIG_SETMASK, nullptr, &before);
  const auto block_and_die = [](void*) {
    static constexpr std::uint64_t kUsers = std::uint64_t{1} << (SIGUSR1 - 1);
    bad::call_kernel(SYS_rt_sigprocmask, SIG_BLOCK, reinterpret_cast<long>(&kUsers), 0, sizeof kUsers);
    bad::write_null(nullptr);
  };
  EXPECT_EQ(barrier.run(kNoDeadline, block_and_die, nullptr).kind, LawFaultKind::bad_access);
  pthread_sigmask(SIG_SETMASK, nullptr, &after);
  for (int signal = 1; signal < SIGRTMAX; ++signal)
    EXPECT_EQ(sigismember(&before, signal), sigismember(&after, signal)) << signal;
}

// The environment of floating-point arithmetic, as far as a program can see it.
bool is_in_order() {
  volatile double one = 1, three = 3, tiny = std::numeric_limits<double>::min();
  const bool nearest = one / three * three == 1;
  const bool denormals = tiny / 2 > 0;
  volatile long double wide = 1;
  wide = wide / 3 * 3;
  return nearest && denormals && std::fegetround() == FE_TONEAREST && wide == 1;
}

LITHE_BAD void upset_arithmetic(void*) {
#if defined(__x86_64__)
  _mm_setcsr((_mm_getcsr() | 0xe040) & ~0x80u);  // round to zero, flush and ignore denormals, trap on invalid
  const std::uint16_t x87 = 0x0c3f;              // round to zero, single precision
  asm volatile("fldcw %0\n\tfld1" : : "m"(x87));
#else
  asm volatile("msr fpcr, %0" : : "r"(std::uint64_t{0x3u << 22 | 1u << 24}));  // round to zero, flush denormals
#endif
}

TEST_F(FaultBarrierTest, AnEnvironmentALawLeavesBehindIsPutRight) {
  FaultBarrier barrier = open_barrier();
  ASSERT_TRUE(is_in_order());
  EXPECT_FALSE(barrier.run(kNoDeadline, upset_arithmetic, nullptr));
  EXPECT_TRUE(is_in_order());
  for (int i = 0; i < 20; ++i) barrier.run(kNoDeadline, upset_arithmetic, nullptr);  // the x87 stack has eight places
  EXPECT_TRUE(is_in_order());
}

TEST_F(FaultBarrierTest, AnEnvironmentALawDiesInIsPutRight) {
  FaultBarrier barrier = open_barrier();
  const auto upset_and_die = [](void*) {
    upset_arithmetic(nullptr);
    bad::write_null(nullptr);
  };
  EXPECT_TRUE(barrier.run(kNoDeadline, upset_and_die, nullptr));
  EXPECT_TRUE(is_in_order());
}

#if defined(__x86_64__)
constexpr std::uint64_t kFlushDenormals = 0x8040;
std::uint64_t arithmetic() { return _mm_getcsr(); }
void set_arithmetic(std::uint64_t word) { _mm_setcsr(static_cast<unsigned>(word)); }
#else
constexpr std::uint64_t kFlushDenormals = 1u << 24;
std::uint64_t arithmetic() {
  std::uint64_t word = 0;
  asm volatile("mrs %0, fpcr" : "=r"(word));
  return word;
}
void set_arithmetic(std::uint64_t word) { asm volatile("msr fpcr, %0" : : "r"(word)); }
#endif

// Had the thread flushed denormals before, so it does afterwards: the handler's own environment is the kernel's.
TEST_F(FaultBarrierTest, WhatTheThreadChoseItselfIsKept) {
  const std::uint64_t before = arithmetic();
  set_arithmetic(before | kFlushDenormals);
  {
    FaultBarrier barrier = open_barrier();
    EXPECT_TRUE(barrier.run(kNoDeadline, bad::write_null, nullptr));
    EXPECT_EQ(arithmetic() & kFlushDenormals, kFlushDenormals);
  }
  set_arithmetic(before);
}

TEST_F(FaultBarrierTest, AnUnmaskedExceptionInALawIsItsFault) {
#if defined(__x86_64__)
  FaultBarrier barrier = open_barrier();
  const auto divide = [](void*) {
    _mm_setcsr(_mm_getcsr() & ~0x200u);
    volatile double one = 1, zero = 0;
    one = one / zero;
  };
  EXPECT_EQ(barrier.run(kNoDeadline, divide, nullptr).kind, LawFaultKind::arithmetic);
  EXPECT_TRUE(is_in_order());
#else
  GTEST_SKIP() << "not every AArch64 core can trap on arithmetic";
#endif
}

#if defined(__x86_64__)
constexpr std::uint64_t kDirection = 1u << 10, kNestedTask = 1u << 14, kAlignment = 1u << 18;

TEST_F(FaultBarrierTest, DirectionAndAlignmentFlagsArePutRight) {
  FaultBarrier barrier = open_barrier();
  const auto set_flags = [](void*) { asm volatile("pushfq\n\torq $0x44400, (%%rsp)\n\tpopfq" : : : "cc", "memory"); };
  const auto set_and_die = [](void*) {
    asm volatile("pushfq\n\torq $0x44400, (%%rsp)\n\tpopfq\n\tmovl $1, 0x10" : : : "cc", "memory");
  };
  EXPECT_FALSE(barrier.run(kNoDeadline, set_flags, nullptr));
  EXPECT_EQ(__builtin_ia32_readeflags_u64() & (kDirection | kNestedTask | kAlignment), 0u);
  serialise_core();  // faults while a law's nested-task flag is up
  if (kHoldsSignals) GTEST_SKIP() << "ThreadSanitizer's own handler runs before ours, and trips over the flag";
  EXPECT_TRUE(barrier.run(kNoDeadline, set_and_die, nullptr));
  EXPECT_EQ(__builtin_ia32_readeflags_u64() & (kDirection | kNestedTask | kAlignment), 0u);
}
#endif

// --- what is not a law's fault ---

class OwnFault : public FaultBarrierTest, public testing::WithParamInterface<int> {};

bool ended_by(int status, int signal) {
  if (WIFSIGNALED(status)) return WTERMSIG(status) == signal;
  return kReportsFaults && WIFEXITED(status) && WEXITSTATUS(status) != 0;
}

void fail_with(int signal) {
  switch (signal) {
    case SIGSEGV:
      return bad::write_null(nullptr);
    case SIGFPE:
      return bad::divide_by_zero(nullptr);
    case SIGILL:
      return bad::execute_garbage(nullptr);
    case SIGTRAP:
      return bad::hit_breakpoint(nullptr);
    case SIGABRT:
      return bad::give_up(nullptr);
    default:
      raise(signal);
  }
}

TEST_P(OwnFault, EndsTheProcessWithItsOwnSignal) {
  const int signal = GetParam();
  const auto ended = [signal](int status) { return ended_by(status, signal); };
  EXPECT_EXIT(
      {
        FaultBarrier barrier = open_barrier();
        barrier.run(kNoDeadline, bad::write_null, nullptr);  // a law's fault before must not excuse ours after
        fail_with(signal);
      },
      ended, "");
  EXPECT_EXIT(
      {
        FaultBarrier barrier = open_barrier();
        std::thread([signal] { fail_with(signal); }).join();  // a thread that runs no laws
      },
      ended, "");
}

// Somebody's kill() while a law happens to run is no law's fault.
TEST_P(OwnFault, OfAnotherProcessEndsThisOne) {
  const int signal = GetParam();
  const auto ended = [signal](int status) { return ended_by(status, signal); };
  EXPECT_EXIT(
      {
        FaultBarrier barrier = open_barrier();
        const pid_t target = getpid();
        if (fork() == 0) {
          std::this_thread::sleep_for(std::chrono::milliseconds(20));
          if (getppid() == target) kill(target, signal);
          _exit(0);
        }
        barrier.run(kNoDeadline, bad::loop_forever, nullptr);
      },
      ended, "");
}

INSTANTIATE_TEST_SUITE_P(EachSignal, OwnFault,
                         testing::Values(SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGTRAP, SIGSYS),
                         [](const auto& signal) { return std::string(sigabbrev_np(signal.param)); });

}  // namespace
}  // namespace lithe::contain
