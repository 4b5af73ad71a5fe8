// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/law_stack.hpp"

#include <array>
#include <cstdint>

#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/test/contain_rig.hpp"

namespace lithe::contain {
namespace {

using wire::LawFaultKind;

class LawStackTest : public testing::Test {
 protected:
  void SetUp() override {
    if (kReportsFaults) GTEST_SKIP() << "the sanitizer's own handler ends the process";
  }
  static void expect_goes_on(FaultBarrier& barrier) {
    int runs = 0;
    EXPECT_FALSE(barrier.run(kNoDeadline, bad::count, &runs));
    EXPECT_EQ(runs, 1);
  }
};

// Where a call's frame is.
LITHE_BAD void tell_frame(void* out) {
  *static_cast<std::uintptr_t*>(out) = reinterpret_cast<std::uintptr_t>(__builtin_frame_address(0));
}

std::uintptr_t frame_in(FaultBarrier& barrier) {
  std::uintptr_t frame = 0;
  EXPECT_FALSE(barrier.run(kNoDeadline, tell_frame, &frame));
  return frame;
}

// An array that is too short, filled as if it were not: what lies above it is saved registers and return addresses.
struct Slip {
  std::size_t words;
};
LITHE_BAD void write_past_a_local(void* slip) {
  auto* word = static_cast<volatile std::uint64_t*>(__builtin_frame_address(0));
  for (std::size_t left = static_cast<Slip*>(slip)->words; left > 0; --left) *word++ = 0x3ff0'0000'0000'0000;
}

TEST_F(LawStackTest, ASlipPastALocalReachesNoFrameOfTheThread) {
  FaultBarrier barrier = open_barrier();
  std::array<volatile std::uint64_t, 64> ours{};
  int faults = 0;
  for (std::size_t words = 1; words <= 2000; ++words) {
    Slip slip{words};
    faults += barrier.run(kNoDeadline, write_past_a_local, &slip) ? 1 : 0;
    for (const volatile std::uint64_t& word : ours) ASSERT_EQ(word, 0u) << words;
  }
  EXPECT_GE(faults, 1998);  // the first words may be ones that nobody misses
  expect_goes_on(barrier);
}

TEST_F(LawStackTest, BothEndsAreGuardedFurtherThanAFrameReaches) {
  FaultBarrier barrier = open_barrier();
  const std::uintptr_t frame = frame_in(barrier);
  const auto ours = reinterpret_cast<std::uintptr_t>(__builtin_frame_address(0));
  EXPECT_GT(frame > ours ? frame - ours : ours - frame, kLawStackBytes);
  const std::uintptr_t top = (frame + 4095) / 4096 * 4096;
  const auto store = [](void* at) { bad::store_at(*static_cast<std::uintptr_t*>(at)); };
  std::uintptr_t inside = top - kLawStackBytes, below = inside - 4, above = top, far_below = inside - kLawGuardBytes;
  EXPECT_FALSE(barrier.run(kNoDeadline, store, &inside));
  for (std::uintptr_t* at : {&below, &above, &far_below})
    EXPECT_EQ(barrier.run(kNoDeadline, store, at).kind, LawFaultKind::bad_access);
  expect_goes_on(barrier);
}

TEST_F(LawStackTest, EachCallBeginsAtItsTopWhateverTheOneBeforeDid) {
  FaultBarrier barrier = open_barrier();
  const std::uintptr_t frame = frame_in(barrier);
  EXPECT_EQ(barrier.run(kNoDeadline, bad::overflow_stack, nullptr).kind, LawFaultKind::bad_access);
  EXPECT_EQ(frame_in(barrier), frame);
}

// A law that clears every register that a function must keep.
#if defined(__x86_64__)
[[gnu::naked]] void keep_no_promise(void*) {
  asm("xorl %ebx, %ebx\n\txorl %ebp, %ebp\n\txorl %r12d, %r12d\n\txorl %r13d, %r13d\n\txorl %r14d, %r14d\n\t"
      "xorl %r15d, %r15d\n\tret");
}
#else
asm(R"(
  .text
  .p2align 2
  .type lithe_test_keep_no_promise, %function
lithe_test_keep_no_promise:
  .irp number, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29
  mov x\number, xzr
  .endr
  .irp number, 8, 9, 10, 11, 12, 13, 14, 15
  fmov d\number, xzr
  .endr
  ret
  .size lithe_test_keep_no_promise, . - lithe_test_keep_no_promise
)");
extern "C" void lithe_test_keep_no_promise(void*);
constexpr auto keep_no_promise = &lithe_test_keep_no_promise;
#endif

TEST_F(LawStackTest, RegistersThatALawPromisedToKeepArePutRight) {
  FaultBarrier barrier = open_barrier();
  std::uint64_t a = 1, b = 2, c = 3, d = 4, e = 5;
  asm volatile("" : "+r"(a), "+r"(b), "+r"(c), "+r"(d), "+r"(e));
#if defined(__aarch64__)
  double p = 1, q = 2, r = 3, s = 4;
  asm volatile("" : "+w"(p), "+w"(q), "+w"(r), "+w"(s));
#endif
  EXPECT_FALSE(barrier.run(kNoDeadline, keep_no_promise, nullptr));
  asm volatile("" : "+r"(a), "+r"(b), "+r"(c), "+r"(d), "+r"(e));
  EXPECT_EQ(a + b + c + d + e, 15u);
#if defined(__aarch64__)
  asm volatile("" : "+w"(p), "+w"(q), "+w"(r), "+w"(s));
  EXPECT_EQ(p + q + r + s, 10);
#endif
  expect_goes_on(barrier);
}

}  // namespace
}  // namespace lithe::contain
