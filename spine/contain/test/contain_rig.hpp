// SPDX-License-Identifier: Apache-2.0
// Test fixtures of this room.
#pragma once

#include <gtest/gtest.h>

#include <atomic>
#include <cstdint>
#include <thread>

#include "spine/contain/fault_barrier.hpp"
#include "spine/contain/watchdog.hpp"
#include "spine/core/time.hpp"

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#define LITHE_ASAN 1
#endif
#endif
#if defined(__SANITIZE_ADDRESS__)
#define LITHE_ASAN 1
#endif
#if defined(__SANITIZE_THREAD__) && !defined(LITHE_THREAD_SANITIZER)
#define LITHE_THREAD_SANITIZER 1
#endif

namespace lithe::contain {

#if defined(LITHE_ASAN) || defined(LITHE_THREAD_SANITIZER)
inline constexpr bool kReportsFaults = true;  // the sanitizer's own handler ends the process, with a report
#else
inline constexpr bool kReportsFaults = false;
#endif
#ifdef LITHE_THREAD_SANITIZER
inline constexpr bool kHoldsSignals = true;  // ThreadSanitizer delays asynchronous signals
#else
inline constexpr bool kHoldsSignals = false;
#endif

inline constexpr std::int64_t kNoDeadline = INT64_MAX;

// A FaultBarrier on the test's own thread, with the handlers of this process.
inline FaultBarrier open_barrier(ProtectedMemory* protected_memory = nullptr) {
  const Result<> installed = install_handlers();
  if (!installed) ADD_FAILURE() << installed.message();
  Result<FaultBarrier> barrier = FaultBarrier::open(protected_memory);
  if (!barrier) ADD_FAILURE() << barrier.message();
  return std::move(*barrier);
}

inline constexpr std::int64_t kBudgetNs = 200'000;

// A running Watchdog.
class Guarded {
 public:
  explicit Guarded(const WatchdogConfig& config = {}) : dog(config) {
    thread_ = std::thread([this] { dog.run(stop_); });
  }
  ~Guarded() {
    stop_.store(true);
    thread_.join();
  }
  Watchdog dog;

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

class WatchdogTest : public testing::Test {
 protected:
  void SetUp() override {
    if (kHoldsSignals) GTEST_SKIP() << "ThreadSanitizer delivers no asynchronous signal to a busy thread";
  }
  static void watch(Watchdog& dog, FaultBarrier& barrier) {
    const Result<> watched = dog.watch(barrier);
    ASSERT_TRUE(watched) << watched.message();
  }
  static std::int64_t deadline() { return monotonic_ns() + kBudgetNs; }
};

}  // namespace lithe::contain
