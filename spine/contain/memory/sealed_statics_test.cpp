// SPDX-License-Identifier: Apache-2.0
// Each test seals in a process of its own: googletest has variables too.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdint>

#include "spine/contain/memory/constants.hpp"
#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"

namespace lithe::contain {
namespace {

volatile std::uint64_t g_zero = 0, g_seven = 7;  // in .bss and in .data

enum Exit : int { kFine = 0, kNotSealed = 10, kWasWritten = 11, kWrongTrouble = 12, kNoBarrier = 13 };

// Runs `what` in a child: its exit code, or minus the signal that ended it.
template <class What>
int in_a_child(What what) {
  const pid_t child = fork();
  if (child == 0) _exit(what());
  int status = 0;
  EXPECT_EQ(waitpid(child, &status, 0), child);
  return WIFSIGNALED(status) ? -WTERMSIG(status) : WEXITSTATUS(status);
}

LITHE_BAD void write_static(void* word) { *static_cast<volatile std::uint64_t*>(word) = 0xbad; }

int write_from_a_law(volatile std::uint64_t& word) {
  if (!install_handlers()) return kNoBarrier;
  Result<FaultBarrier> barrier = FaultBarrier::open();
  if (!barrier) return kNoBarrier;
  const Result<SealedStatics> sealed = SealedStatics::seal();
  if (!sealed) return kNotSealed;
  auto* const address = const_cast<std::uint64_t*>(&word);
  const std::uint64_t before = word;
  const Failure failure = barrier->run(kNoDeadline, write_static, address);
  if (word != before) return kWasWritten;
  const bool named =
      failure.kind == wire::LawFaultKind::bad_access && failure.address == reinterpret_cast<std::uintptr_t>(address);
  return named ? kFine : kWrongTrouble;
}

TEST(SealedStatics, ALawThatWritesAVariableOfTheProgramFaultsThere) {
  EXPECT_EQ(in_a_child([] { return write_from_a_law(g_zero); }), kFine);
  EXPECT_EQ(in_a_child([] { return write_from_a_law(g_seven); }), kFine);
}

// The twin: unsealed, the same write goes through.
TEST(SealedStatics, WithoutItTheWriteIsNotNoticed) {
  const auto unsealed = [] {
    if (!install_handlers()) return kNoBarrier;
    Result<FaultBarrier> barrier = FaultBarrier::open();
    if (!barrier) return kNoBarrier;
    const Failure failure = barrier->run(kNoDeadline, write_static, const_cast<std::uint64_t*>(&g_zero));
    return !failure && g_zero == 0xbad ? kWasWritten : kWrongTrouble;
  };
  EXPECT_EQ(in_a_child(unsealed), kWasWritten);
}

TEST(SealedStatics, TheProgramItselfCannotWriteEither) {
  const auto write = [] {
    const Result<SealedStatics> sealed = SealedStatics::seal();
    g_zero = 1;
    return kWasWritten;
  };
  EXPECT_EQ(in_a_child(write), -SIGSEGV);
}

TEST(SealedStatics, AfterwardsTheProgramWritesAgain) {
  const auto write_later = [] {
    if (Result<SealedStatics> sealed = SealedStatics::seal(); !sealed || sealed->bytes() == 0) return kNotSealed;
    g_zero = 1;
    g_seven = 8;
    return g_zero + g_seven == 9 ? kFine : kWrongTrouble;
  };
  EXPECT_EQ(in_a_child(write_later), kFine);
}

}  // namespace
}  // namespace lithe::contain
