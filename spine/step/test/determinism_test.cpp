// SPDX-License-Identifier: Apache-2.0
// The same inputs give the same bits: run A == run B == a replay of what A was given.
#include <gtest/gtest.h>

#include <bit>
#include <cstdint>
#include <string>

#include "spine/step/test/run_rig.hpp"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define LITHE_SLOW 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || __has_feature(realtime_sanitizer)
#define LITHE_SLOW 1
#endif
#endif

namespace lithe::step {
namespace {

#ifdef LITHE_SLOW
constexpr double kSeconds = 10;  // the Brain pauses after eight
#else
constexpr double kSeconds = 60;  // of the robot's time
#endif

robot::RobotConfig robot_of(const std::string& name) {
  auto robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/" + name + ".toml");
  EXPECT_TRUE(robot) << robot.message();
  robot->inputs.push_back({"push_nm", -0.1, 0.1, 0});
  return *robot;
}

void flip_last_bit(double& value) { value = std::bit_cast<double>(std::bit_cast<std::uint64_t>(value) ^ 1); }

bool begins(const std::string& text, const char* with) { return text.rfind(with, 0) == 0; }

// A, B and the replay run side by side, so that whatever they share by mistake differs between them. After every tick
// all of their outputs are compared.
class Runs {
 public:
  explicit Runs(const std::string& name, const LitheLaw* twin = nullptr)
      : robot_(robot_of(name)), a_(robot_, twin), b_(robot_, twin), replay_(robot_) {}

  // "" or the first difference. `change` may change what the replay is given.
  std::string first_difference(double seconds, void (*change)(Given&) = [](Given&) {}) {
    const auto ticks = static_cast<std::uint64_t>(seconds * robot_.rate_hz);
    for (std::uint64_t tick = 1; tick <= ticks; ++tick) {
      Given given = a_.tick();
      b_.tick();
      change(given);
      ReplayHost host(given);
      replay_.run(given, host);
      if (const std::string what = b_.stepper().differs_from(a_.stepper()); !what.empty())
        return "run B, tick " + std::to_string(tick) + ": " + what;
      if (const std::string what = replay_.differs_from(a_.stepper()); !what.empty())
        return "replay, tick " + std::to_string(tick) + ": " + what;
    }
    return "";
  }
  const Loop& a() const { return a_; }

 private:
  robot::RobotConfig robot_;
  Loop a_, b_;
  Stepper replay_;
};

class Determinism : public testing::TestWithParam<const char*> {};

TEST_P(Determinism, TwoRunsAndAReplayGiveTheSameBits) {
  Runs runs(GetParam());
  EXPECT_EQ(runs.first_difference(kSeconds), "");
  // It was not a robot that stands still.
  EXPECT_GT(runs.a().moving_share(), 0.5);
  for (const wire::EventKind kind :
       {wire::EventKind::armed, wire::EventKind::law_committed, wire::EventKind::law_faulted,
        wire::EventKind::law_rolled_back, wire::EventKind::shadow_ended, wire::EventKind::params_applied,
        wire::EventKind::sample_late, wire::EventKind::brain_stale}) {
    EXPECT_GT(runs.a().happened(kind), 0u) << wire::to_string(kind);
  }
}
INSTANTIATE_TEST_SUITE_P(Robots, Determinism, testing::Values("arm", "frankenstein", "chain"),
                         [](const auto& robot) { return std::string(robot.param); });

TEST(BrokenTwin, ALawThatReadsAClockIsSeen) { EXPECT_NE(Runs("arm", &kReadsAClock).first_difference(3), ""); }

TEST(BrokenTwin, ALawThatRemembersOutsideItsStateIsSeen) {
  EXPECT_NE(Runs("arm", &kRemembersOutside).first_difference(3), "");
}

TEST(BrokenTwin, OneBitOfOneInputIsSeen) {
  const std::string sample = Runs("chain").first_difference(3, [](Given& given) {
    if (given.tick == 2000) flip_last_bit(given.sample.position_rad[0]);
  });
  EXPECT_TRUE(begins(sample, "replay, tick 2000: ")) << sample;
  // Of a waypoint 20 ms ahead, which is in no record.
  const std::string plan = Runs("chain").first_difference(3, [](Given& given) {
    if (given.tick == 2007) flip_last_bit(given.plan->position_rad[wire::kNj]);
  });
  EXPECT_TRUE(begins(plan, "replay, tick 20")) << plan;
  // Of one that steps at once.
  const std::string step = Runs("chain").first_difference(5, [](Given& given) {
    if (given.tick == 4507) flip_last_bit(given.plan->position_rad[0]);
  });
  EXPECT_TRUE(begins(step, "replay, tick 4507: ")) << step;
}

TEST(BrokenTwin, AnAnswerOfTheHostIsAnInputToo) {
  const std::string found = Runs("arm").first_difference(3, [](Given& given) {
    if (given.tick == 2050) given.failures[0].kind = wire::LawFaultKind::overran;
  });
  EXPECT_TRUE(begins(found, "replay, tick 2050: ")) << found;
}

}  // namespace
}  // namespace lithe::step
