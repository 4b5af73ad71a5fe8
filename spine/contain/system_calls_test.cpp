// SPDX-License-Identifier: Apache-2.0
// Each in a process of its own: what is taken from a thread cannot all be given back.
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <ctime>
#include <memory>
#include <string>
#include <thread>

#include "spine/contain/core.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/contain/memory/protected_memory.hpp"
#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"
#include "spine/contain/watchdog.hpp"
#include "spine/core/time.hpp"

namespace lithe::contain {
namespace {

using wire::LawFaultKind;

constexpr int kHeld = 0, kNotHeld = 1, kNoSuchGate = 2;

// A gated thread, with a Watchdog and somebody who keeps sending it signals for calls that are over.
struct Scene {
  FaultBarrier& barrier;
  Watchdog& dog;
  std::atomic<bool>& hail;
};
using Story = bool (*)(Scene&);

int play(CallGate gate, Story story, ProtectedMemory* protected_memory, Watchdog& dog, std::atomic<pid_t>& thread,
         std::atomic<bool>& hail) {
  if (!install_handlers()) return kNotHeld;
  Result<FaultBarrier> barrier = FaultBarrier::open(protected_memory);
  if (!barrier || !dog.watch(*barrier)) return kNotHeld;
  thread.store(static_cast<pid_t>(syscall(SYS_gettid)));
  const Result<CallGate> got = barrier->forbid_system_calls({}, gate);
  if (!got || *got != gate) return kNoSuchGate;
  Scene scene{*barrier, dog, hail};
  const bool held = story(scene);
  hail.store(false);
  return held ? kHeld : kNotHeld;
}

// Runs in the child: exits 0 when `story` is true on a gated thread of its own.
[[noreturn]] void tell(CallGate gate, Story story, bool in_vault = false) {
  int result = kNotHeld;
  std::unique_ptr<ProtectedMemory> protected_memory;
  if (in_vault) protected_memory = std::move(*ProtectedMemory::make(1 << 16));
  Watchdog dog;
  std::atomic<bool> stop{false}, hail{false};
  std::atomic<pid_t> target{0};
  std::thread watching([&] { dog.run(stop); });
  std::thread hailing([&] {
    while (!stop.load()) {
      if (hail.load()) send_watch_signal(target.load(), UINT64_MAX, Ask::end);
      std::this_thread::sleep_for(std::chrono::microseconds(1));
    }
  });
  std::thread([&] {
    result = play(gate, story, protected_memory.get(), dog, target, hail);
  }).join();  // it ends by system calls
  stop.store(true);
  watching.join();
  hailing.join();
  _exit(result);
}

class Gate : public testing::TestWithParam<CallGate> {
 public:
  void SetUp() override {
    if (kReportsFaults) GTEST_SKIP() << "a sanitizer's runtime makes system calls of its own, also in a law";
    if (!exists(GetParam())) GTEST_SKIP() << "this kernel has no such gate";
  }
  // Asks the kernel without our code, so that a gate we broke is not taken for one that is not there.
  static bool exists(CallGate gate) {
    constexpr int kDispatch = 59, kOff = 0;  // PR_SET_SYSCALL_USER_DISPATCH
    return gate == CallGate::dispatch ? prctl(kDispatch, kOff, 0ul, 0ul, 0ul) == 0 : prctl(PR_GET_SECCOMP) >= 0;
  }
  static bool held(int status) { return WIFEXITED(status) && WEXITSTATUS(status) == kHeld; }
};

bool law_is_caught(Scene& scene) {
  for (int i = 0; i < 100; ++i) {
    const Failure failure = scene.barrier.run(kNoDeadline, bad::ask_for_parent, nullptr);
    if (failure.kind != LawFaultKind::system_call || failure.address != SYS_getppid) return false;
    const auto call = reinterpret_cast<std::uintptr_t>(&bad::call_kernel);
    if (failure.pc < call || failure.pc > call + 256) return false;
    if (scene.barrier.run(kNoDeadline, bad::nothing, nullptr)) return false;
  }
  return true;
}

TEST_P(Gate, ALawsSystemCallIsItsFault) {
  EXPECT_EXIT(tell(GetParam(), law_is_caught), held, "");
  EXPECT_EXIT(tell(GetParam(), law_is_caught, true), held, "") << "with the gate's switch in a protected memory";
}

bool crashes_are_contained(Scene& scene) {
  for (std::size_t i = 0; i < 20 * bad::kCrashes.size(); ++i) {
    const bad::Case& each = bad::kCrashes[i % bad::kCrashes.size()];
    const LawFaultKind kind = scene.barrier.run(kNoDeadline, each.call, nullptr).kind;
    // abort() asks the kernel to send the signal: a gate may see that first.
    const bool gated = each.kind == LawFaultKind::aborted && kind == LawFaultKind::system_call;
    if (kind != each.kind && !gated) return false;
  }
  return true;
}

TEST_P(Gate, CrashesAreContainedBehindIt) {
  EXPECT_EXIT(tell(GetParam(), crashes_are_contained), held, "");
  EXPECT_EXIT(tell(GetParam(), crashes_are_contained, true), held, "");
}

bool thread_still_sleeps(Scene& scene) {
  for (int i = 0; i < 5; ++i) {
    const timespec pause{0, 100'000};
    if (clock_nanosleep(CLOCK_MONOTONIC, 0, &pause, nullptr) != 0) return false;
    if (scene.barrier.run(kNoDeadline, i % 2 == 0 ? bad::nothing : bad::write_null, nullptr).kind ==
        LawFaultKind::system_call)
      return false;
  }
  return true;
}

TEST_P(Gate, TheThreadItselfStillWaitsAndEnds) { EXPECT_EXIT(tell(GetParam(), thread_still_sleeps), held, ""); }

bool loop_is_broken_off(Scene& scene) {
  for (int i = 0; i < 20; ++i) {
    const Failure failure = scene.barrier.run(monotonic_ns() + 200'000, bad::loop_forever, nullptr);
    if (failure.kind != LawFaultKind::overran) return false;
  }
  return true;
}

TEST_P(Gate, AnEndlessLoopIsBrokenOffBehindIt) {
  EXPECT_EXIT(tell(GetParam(), loop_is_broken_off), held, "");
  EXPECT_EXIT(tell(GetParam(), loop_is_broken_off, true), held, "");
}

// A handler returns by a system call, also while the law's own are shut; and shut they are still when it has.
bool late_signals_change_nothing(Scene& scene) {
  const auto wait_and_call = [](void* barrier) {
    const auto* own = static_cast<FaultBarrier*>(barrier);
    const std::uint64_t from = own->late_signals();
    while (own->late_signals() < from + 3) spin_pause();
    bad::ask_for_parent(nullptr);
  };
  scene.hail.store(true);
  for (int i = 0; i < 20; ++i)
    if (scene.barrier.run(kNoDeadline, wait_and_call, &scene.barrier).kind != LawFaultKind::system_call) return false;
  return true;
}

TEST_P(Gate, LateSignalsNeitherEndALawNorOpenTheGate) {
  EXPECT_EXIT(tell(GetParam(), late_signals_change_nothing), held, "");
  EXPECT_EXIT(tell(GetParam(), late_signals_change_nothing, true), held, "");
}

bool thread_breaks_the_rule(Scene& scene) {
  const Failure fault = scene.barrier.run(kNoDeadline, bad::ask_for_parent, nullptr);
  bad::ask_for_parent(nullptr);
  return static_cast<bool>(fault);
}

TEST(Gates, TheThreadsOwnCallsAreFreeBehindADispatchAndEndTheProcessBehindAFilter) {
  if (kReportsFaults) GTEST_SKIP() << "a sanitizer's runtime makes system calls of its own, also in a law";
  if (Gate::exists(CallGate::dispatch))
    EXPECT_EXIT(tell(CallGate::dispatch, thread_breaks_the_rule), testing::ExitedWithCode(kHeld), "");
  if (!Gate::exists(CallGate::filter)) GTEST_SKIP() << "this kernel has no filter";
  EXPECT_EXIT(tell(CallGate::filter, thread_breaks_the_rule), testing::KilledBySignal(SIGSYS), "");
}

INSTANTIATE_TEST_SUITE_P(Each, Gate, testing::Values(CallGate::dispatch, CallGate::filter), [](const auto& gate) {
  return std::string(gate.param == CallGate::dispatch ? "Dispatch" : "Filter");
});

}  // namespace
}  // namespace lithe::contain
