// SPDX-License-Identifier: Apache-2.0
// What a trial rests on: how its end is judged, the child's walls, the memory a law is given.
#include "trial/verdict.hpp"

#include <gtest/gtest.h>
#include <signal.h>

#include <cstdlib>
#include <cstring>

#include "spine/core/test/emulation_rig.hpp"
#include "trial/sandbox/sandbox.hpp"
#include "trial/sections/law_harness.hpp"

namespace lithe::trial {
namespace {

TEST(Verdict, LiesOfAChildAreNotBelieved) {
  Report report;
  report.ended = 1;
  for (std::size_t i = 1; i < kSections; ++i) report.progress[i].done = 1;
  const auto bytes = [&] { return std::string(reinterpret_cast<const char*>(&report), sizeof report); };
  Outcome outcome;
  outcome.started = true;
  outcome.exit_code = 0;
  outcome.output = bytes();
  EXPECT_TRUE(verdict_of(outcome, {}).ok);
  outcome.exit_code = 1;
  EXPECT_FALSE(verdict_of(outcome, {}).ok) << "it did not end well";
  outcome.exit_code = 0;
  outcome.output = bytes().substr(1);
  EXPECT_FALSE(verdict_of(outcome, {}).ok) << "half a report";
  outcome.output = "";
  EXPECT_FALSE(verdict_of(outcome, {}).ok) << "no report";
  report.progress[3].done = 0;
  outcome.output = bytes();
  EXPECT_FALSE(verdict_of(outcome, {}).ok) << "a part is missing";
  report.progress[3].done = 1;
  report.section = 77;
  outcome.output = bytes();
  EXPECT_FALSE(verdict_of(outcome, {}).ok) << "no such section";
  report.section = 0;
  report.ended = 0;
  outcome.output = bytes();
  EXPECT_FALSE(verdict_of(outcome, {}).ok) << "not at its end";
}

TEST(Verdict, StarvedTrialIsNotTheLawsFault) {
  Outcome outcome;
  outcome.started = outcome.timed_out = true;
  outcome.signal = 9;
  outcome.cpu_ms = 5;
  EXPECT_TRUE(verdict_of(outcome, {}).starved);
  EXPECT_FALSE(verdict_of(outcome, {}).out_of_time);
  outcome.cpu_ms = 149;
  EXPECT_TRUE(verdict_of(outcome, {}).out_of_time);
  EXPECT_FALSE(verdict_of(outcome, {}).starved);
}

TEST(Verdict, WhatIsTooMuchIsToldWithWhatATrialHas) {
  Report report;
  report.crash.signal = SIGPROF;
  Outcome outcome;
  outcome.started = true;
  outcome.output = {reinterpret_cast<const char*>(&report), sizeof report};
  EXPECT_NE(verdict_of(outcome, {.cpu_ms = 170}).reason.find("170 ms of the processor"), std::string::npos);
  outcome.output = "";
  outcome.signal = SIGKILL;
  const std::string killed = verdict_of(outcome, {}).reason;
  EXPECT_NE(killed.find("512 MiB of memory, 150 ms"), std::string::npos) << killed;
}

TEST(Verdict, SandboxThatDoesNotWorkIsNotTheLawsFault) {
  EXPECT_TRUE(verdict_of({}, {}).unable) << "there was no child";
  Report report;
  report.ended = report.unable = 1;
  report.refused = {"no filter"};
  Outcome outcome;
  outcome.started = true;
  outcome.exit_code = 1;
  outcome.output = std::string(reinterpret_cast<const char*>(&report), sizeof report);
  EXPECT_TRUE(verdict_of(outcome, {}).unable);
  EXPECT_FALSE(verdict_of(outcome, {}).ok) << "but it is not tried";
  report.unable = 0;
  outcome.output = std::string(reinterpret_cast<const char*>(&report), sizeof report);
  EXPECT_FALSE(verdict_of(outcome, {}).unable);
}

TEST(Sandbox, ChildThatDoesNotEndIsKilled) {
  Limits limits;
  limits.wall_ms = 50;
  const auto before =
      signal(SIGPROF, SIG_IGN);  // the question where it is; here, as a slow child is asked before it begins
  const Outcome outcome = run_sandboxed(
      [](int) {
        for (volatile int x = 1; x != 0;) x = 1;
        return 0;
      },
      limits, 10);
  signal(SIGPROF, before);
  EXPECT_TRUE(outcome.timed_out);
  EXPECT_EQ(outcome.signal, 9);
}

TEST(Sandbox, MemoryThatLiesReadyIsAllocatedWithoutTheKernel) {
  if (kSanitized) GTEST_SKIP() << "a sanitizer has an allocator of its own";
  if (const std::string why = test::why_no_trial(); !why.empty()) GTEST_SKIP() << why;
  for (const bool ready : {true, false}) {
    const auto allocate = [&](int pipe_fd) {
      if (!shed_rights(pipe_fd, {}) || (ready && !keep_heap(8 << 20)) || !allow_computing_only(3)) return 2;
      for (std::size_t kib = 1; kib <= 4096; kib *= 2) {
        void* volatile memory = std::malloc(kib << 10);
        if (memory == nullptr) return 3;
        std::memset(memory, 1, kib << 10);
        std::free(memory);
      }
      return 0;
    };
    const Outcome outcome = run_sandboxed(allocate, {}, 10);
    EXPECT_EQ(outcome.signal, ready ? 0 : SIGSYS);
    EXPECT_EQ(outcome.exit_code == 0, ready);
  }
}

TEST(GuardedTest, FenceRemembersWhatWasWrittenBeforeTheBytes) {
  const Guarded memory(24, Guarded::Kind::with_read_only_view);
  std::memset(memory.data(), 7, 24);
  EXPECT_EQ(memory.law_view()[23], std::byte{7}) << "both views show the same bytes";
  EXPECT_TRUE(memory.fence_intact());
  for (const std::ptrdiff_t before : {1, 2, 1000, 4072}) {
    const std::byte was = memory.data()[-before];
    memory.data()[-before] = std::byte{0};
    EXPECT_FALSE(memory.fence_intact()) << before;
    memory.data()[-before] = was;
  }
  EXPECT_TRUE(memory.fence_intact());
}

TEST(GuardedDeathTest, WritingPastTheEndOrIntoTheLawsViewIsAnAccessViolation) {
  if (kSanitized) GTEST_SKIP() << "a sanitizer answers with words of its own";
  const Guarded memory(24, Guarded::Kind::with_read_only_view);
  EXPECT_DEATH(*const_cast<volatile std::byte*>(memory.data() + 24) = std::byte{1}, "");
  EXPECT_DEATH(*const_cast<volatile std::byte*>(memory.law_view()) = std::byte{1}, "");
}

}  // namespace
}  // namespace lithe::trial
