// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/handover.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "spine/core/time.hpp"

namespace lithe::loop {
namespace {

// Marks a whole buffer with one number, so that a mixture of two is seen.
void mark(hal::ActuatorCommand& command, std::uint64_t number) {
  command.tick = number;
  command.torque_nm.fill(static_cast<double>(number));
  command.max_torque_nm.fill(static_cast<double>(number));
}

bool whole(const hal::ActuatorCommand& command) {
  for (const double value : command.torque_nm)
    if (value != static_cast<double>(command.tick)) return false;
  for (const double value : command.max_torque_nm)
    if (value != static_cast<double>(command.tick)) return false;
  return true;
}

bool whole(const hal::ActuatorState& state) {
  for (const double value : state.position_rad)
    if (value != static_cast<double>(state.tick)) return false;
  return true;
}

// What went wrong in a run of `ticks` exchanges with a Transport that answers each command with its number.
struct Outcome {
  std::uint64_t torn_commands = 0;
  std::uint64_t torn_samples = 0;
  std::uint64_t wrong_samples = 0;
  std::uint64_t late = 0;
};

// The tick side runs against the clock of its own loop, not against the Transport: it overtakes it now and then. Also
// where both share one core: the tick lets the Transport in, which stays at one command for a while.
// `respects_idle` false is the broken twin: a tick that dispatches without asking whether the Transport is done.
Outcome exchange(std::uint64_t ticks, bool respects_idle) {
  Handover handover;
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> now{0};
  std::atomic<std::uint64_t> torn_commands{0};
  std::thread transport([&] {
    std::uint64_t taken = 0;
    while (!stop.load()) {
      if (!handover.pending()) {
        spin_pause();
        continue;
      }
      const std::uint64_t number = handover.command().tick;
      hal::ActuatorState& sample = handover.sample();
      sample.tick = number;
      for (double& value : sample.position_rad) value = static_cast<double>(number);
      const std::uint64_t later = now.load() + (++taken % 8 == 0 ? 100 : 0);
      while (now.load() < later && !stop.load()) std::this_thread::yield();
      if (!whole(handover.command()) || handover.command().tick != number) ++torn_commands;
      handover.finish();
    }
  });
  Outcome outcome;
  std::uint64_t sent = 0;
  for (std::uint64_t k = 1; k <= ticks; ++k) {
    if (handover.idle()) {
      if (sent != 0 && handover.latest_sample().tick != sent) ++outcome.wrong_samples;
      if (!whole(handover.latest_sample())) ++outcome.torn_samples;
    }
    if (handover.idle() || !respects_idle) {
      sent = handover.next_command().tick;
      handover.dispatch();
    } else {
      ++outcome.late;
    }
    mark(handover.next_command(), k);
    now = k;
    if (k % 4096 == 0) std::this_thread::yield();
  }
  stop = true;
  transport.join();
  outcome.torn_commands = torn_commands;
  return outcome;
}

TEST(Handover, TheFirstCommandWaitsForADispatch) {
  Handover handover;
  EXPECT_TRUE(handover.idle());
  EXPECT_FALSE(handover.pending());
  mark(handover.next_command(), 7);
  handover.dispatch();
  EXPECT_FALSE(handover.idle());
  ASSERT_TRUE(handover.pending());
  EXPECT_EQ(handover.command().tick, 7u);
  handover.sample().tick = 7;
  handover.finish();
  EXPECT_TRUE(handover.idle());
  EXPECT_EQ(handover.latest_sample().tick, 7u);
}

TEST(Handover, ALateTransportCostsADispatchAndNeverABuffer) {
  const Outcome outcome = exchange(200'000, true);
  EXPECT_EQ(outcome.torn_commands, 0u);
  EXPECT_EQ(outcome.torn_samples, 0u);
  EXPECT_EQ(outcome.wrong_samples, 0u);
  EXPECT_GT(outcome.late, 0u) << "the test must have overtaken the Transport to mean anything";
}

#ifndef LITHE_THREAD_SANITIZER
TEST(Handover, ATickThatDoesNotAskIsCaught) {
  // The twin is a data race by design, so it does not run under ThreadSanitizer, which would rightly stop it.
  Outcome worst;
  for (int round = 0; round < 50 && worst.torn_commands + worst.wrong_samples == 0; ++round)
    worst = exchange(200'000, false);
  EXPECT_GT(worst.torn_commands + worst.wrong_samples + worst.torn_samples, 0u);
}
#endif

}  // namespace
}  // namespace lithe::loop
