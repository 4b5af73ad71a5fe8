// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/memory/protected_memory.hpp"

#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cstring>
#include <string>
#include <thread>

#include "spine/contain/core.hpp"
#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"
#include "spine/core/time.hpp"

namespace lithe::contain {
namespace {

using wire::LawFaultKind;

struct Critical {
  std::array<std::uint64_t, 64> word{};
};

class ProtectedMemoryTest : public testing::Test, public testing::WithParamInterface<Protection> {
 protected:
  void SetUp() override {
    Result<std::unique_ptr<ProtectedMemory>> made = ProtectedMemory::make(1 << 16, GetParam());
    if (!made && GetParam() == Protection::keys) GTEST_SKIP() << made.message();
    ASSERT_TRUE(made) << made.message();
    protected_memory = std::move(*made);
    critical = protected_memory->create<Critical>();
    ASSERT_NE(critical, nullptr);
    for (std::size_t i = 0; i < critical->word.size(); ++i) critical->word[i] = i;
  }
  FaultBarrier guarding_cell() {
    FaultBarrier barrier = open_barrier(protected_memory.get());
    const Result<> guarded = barrier.guard(critical, sizeof *critical);
    EXPECT_TRUE(guarded) << guarded.message();
    return barrier;
  }
  bool is_whole() const {
    for (std::size_t i = 0; i < critical->word.size(); ++i)
      if (critical->word[i] != i) return false;
    return true;
  }
  std::unique_ptr<ProtectedMemory> protected_memory;
  Critical* critical = nullptr;
};

LITHE_BAD void write_word(void* word) { *static_cast<volatile std::uint64_t*>(word) = 0xbad; }

TEST_P(ProtectedMemoryTest, AWildWriteIsReportedWithItsAddressAndUndone) {
  FaultBarrier barrier = guarding_cell();
  for (std::size_t i = 0; i < critical->word.size(); ++i) {
    const Failure failure = barrier.run(kNoDeadline, write_word, &critical->word[i]);
    ASSERT_EQ(failure.kind, LawFaultKind::state_broken) << i;
    ASSERT_EQ(failure.address, reinterpret_cast<std::uintptr_t>(&critical->word[i]));
    ASSERT_TRUE(is_whole());
    ASSERT_FALSE(barrier.run(kNoDeadline, bad::nothing, nullptr));
  }
}

TEST_P(ProtectedMemoryTest, ALawThatBreaksItAndThenCrashesLeavesItWhole) {
  FaultBarrier barrier = guarding_cell();
  const auto both = [](void* word) {
    write_word(word);
    bad::write_null(nullptr);
  };
  EXPECT_TRUE(barrier.run(kNoDeadline, both, &critical->word[3]));
  EXPECT_TRUE(is_whole());
}

TEST_P(ProtectedMemoryTest, TheThreadItselfWritesBetweenCallsAlsoAfterACrash) {
  FaultBarrier barrier = guarding_cell();
  for (std::uint64_t i = 1; i <= 100; ++i) {
    critical->word[0] = i;
    ASSERT_TRUE(barrier.run(kNoDeadline, bad::kCrashes[i % bad::kCrashes.size()].call, nullptr));
    critical->word[1] = i;
    ASSERT_FALSE(barrier.run(kNoDeadline, bad::nothing, nullptr));
    ASSERT_EQ(critical->word[0], i);
    ASSERT_EQ(critical->word[1], i);
  }
}

TEST_P(ProtectedMemoryTest, ALawReadsItAndWritesOutside) {
  FaultBarrier barrier = guarding_cell();
  struct Read {
    const Critical* from;
    std::uint64_t sum;
  } read{critical, 0};
  const auto add_up = [](void* context) {
    auto* r = static_cast<Read*>(context);
    for (const std::uint64_t word : r->from->word) r->sum += word;
  };
  EXPECT_FALSE(barrier.run(kNoDeadline, add_up, &read));
  EXPECT_EQ(read.sum, 63u * 64 / 2);
}

TEST_P(ProtectedMemoryTest, AnotherThreadMayWriteWhileALawRuns) {
  auto* shared = protected_memory->create<std::atomic<std::uint64_t>>(0u);
  ASSERT_NE(shared, nullptr);
  FaultBarrier barrier = guarding_cell();
  std::atomic<bool> stop{false};
  std::thread other([&] {
    while (!stop.load()) shared->fetch_add(1);
  });
  const auto wait_for_more = [](void* word) {
    const auto* value = static_cast<std::atomic<std::uint64_t>*>(word);
    const std::uint64_t from = value->load();
    while (value->load() < from + 10) spin_pause();
  };
  for (int i = 0; i < 10; ++i) EXPECT_FALSE(barrier.run(kNoDeadline, wait_for_more, shared));
  stop.store(true);
  other.join();
}

// A signal that comes too late must not leave the protected memory open for the rest of the call.
TEST_P(ProtectedMemoryTest, ALateSignalDoesNotOpenIt) {
  if (kHoldsSignals) GTEST_SKIP() << "ThreadSanitizer delivers no asynchronous signal to a busy thread";
  FaultBarrier barrier = guarding_cell();
  struct Law {
    siginfo_t message = watch_message(UINT64_MAX, Ask::end);
    long thread = syscall(SYS_gettid);
    void* word = nullptr;
  } law;
  law.word = &critical->word[0];
  const auto late_then_write = [](void* context) {
    auto* own = static_cast<Law*>(context);
    bad::call_kernel(SYS_rt_tgsigqueueinfo, own->message.si_pid, own->thread, own->message.si_signo,
                     reinterpret_cast<long>(&own->message));
    write_word(own->word);
  };
  EXPECT_EQ(barrier.run(kNoDeadline, late_then_write, &law).kind, LawFaultKind::state_broken);
  EXPECT_EQ(barrier.late_signals(), 1u);
  EXPECT_TRUE(is_whole());
}

TEST_P(ProtectedMemoryTest, WhenItIsFullItSaysSo) {
  EXPECT_EQ(protected_memory->allocate(1 << 16), nullptr);
  EXPECT_NE(protected_memory->allocate(1 << 10), nullptr);
  std::array<std::uint64_t, 8> outside{};
  if (GetParam() == Protection::keys) {
    EXPECT_FALSE(protected_memory->guard(outside.data(), sizeof outside));
  } else {
    for (std::size_t i = 0; i < kMaxGuardedBlocks; ++i)
      EXPECT_TRUE(protected_memory->guard(outside.data(), sizeof outside));
    EXPECT_FALSE(protected_memory->guard(outside.data(), sizeof outside));
  }
}

INSTANTIATE_TEST_SUITE_P(Both, ProtectedMemoryTest, testing::Values(Protection::keys, Protection::copies),
                         [](const auto& how) {
                           return std::string(how.param == Protection::keys ? "Keys" : "Copies");
                         });

// A wild write can hit the copy as well as the block: the block, which nobody touched, must win.
TEST(ProtectedMemoryCopies, AWriteIntoACopyIsNoticedAndNeverCopiedBack) {
  Result<std::unique_ptr<ProtectedMemory>> protected_memory = ProtectedMemory::make(4096, Protection::copies);
  ASSERT_TRUE(protected_memory);
  auto* block = static_cast<unsigned char*>((*protected_memory)->allocate(64));
  std::memset(block, 7, 64);
  ASSERT_TRUE((*protected_memory)->guard(block, 64));
  for (int which = 0; which < 3; ++which) {
    (*protected_memory)->remember();
    block[64 * which + 5] = 9;  // the block, its copy, its second copy: one after the other
    EXPECT_EQ((*protected_memory)->check(), block + 64 * which + 5);
    for (int i = 0; i < 64; ++i) EXPECT_EQ(block[i], 7);
    (*protected_memory)->remember();
    EXPECT_EQ((*protected_memory)->check(), nullptr);
  }
}

}  // namespace
}  // namespace lithe::contain
