// SPDX-License-Identifier: Apache-2.0
#include "spine/load/loader.hpp"

#include <gtest/gtest.h>

#include <cstring>

#include "spine/contain/test/contain_rig.hpp"

namespace lithe::load {
namespace {

// Its filter starts where the joint has been turning lately.
struct Warm {
  struct Params {};
  struct State {
    double mean_rad_s = -1;
    double newest_rad = -1;
    double oldest_age_s = -1;
    std::uint32_t seen = 0;
    std::uint32_t joints = 0;
    double newest_sensor = -1;
    double oldest_sensor = -1;
  };
  static void init(const History& past, const Params&, State& s) {
    s.seen = past.count;
    s.joints = past.joints;
    s.mean_rad_s = 0;
    for (const PastTick& tick : past) s.mean_rad_s += tick.velocity_rad_s[0] / past.count;
    if (past.count == 0) return;
    s.newest_rad = past[0].position_rad[0];
    s.oldest_age_s = past[past.count - 1].age_s;
    s.newest_sensor = past[0].sensor[kMaxSensors - 1];
    s.oldest_sensor = past[past.count - 1].sensor[kMaxSensors - 1];
  }
  static void step(const Tick&, const Params&, State&, Effort& u) { u.torque_nm[0] = 0; }
};
volatile std::uintptr_t nowhere = 8;
struct BadStart {
  struct Params {};
  struct State {
    double x = 0;
  };
  static void init(const History&, const Params&, State& s) { s.x = *reinterpret_cast<const double*>(nowhere); }
  static void step(const Tick&, const Params&, State&, Effort&) {}
};
struct BadStep {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) { u.torque_nm[0] = 1 / t.velocity_rad_s[0]; }
};
constexpr LitheLaw kWarm = describe<Warm>("warm");
constexpr LitheLaw kBadStart = describe<BadStart>("bad_start");
constexpr LitheLaw kBadStep = describe<BadStep>("bad_step");

class RehearsalTest : public testing::Test {
 protected:
  // `count` ticks 1 ms apart, the last one at now_ns_; the joint turns at 2 rad/s and reaches 0.002 rad * k.
  void live(std::uint32_t count) {
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> writer(spine_->telemetry);
    wire::Telemetry record{};
    for (std::uint32_t k = 0; k < count; ++k) {
      now_ns_ += 1'000'000;
      record.release_ns = now_ns_;
      record.position_rad[0] = 0.002 * k;
      record.velocity_rad_s[0] = 2;
      record.sensor[kMaxSensors - 1] = 100 + k;
      writer.push(record);
    }
  }
  Warm::State started(std::uint32_t count) {
    live(count);
    EXPECT_TRUE(prepare(kWarm)) << why_.data();
    Warm::State state;
    std::memcpy(&state, law_->state.data(), sizeof state);
    return state;
  }
  bool prepare(const LitheLaw& law) {
    law::reset_resident(*law_, law);
    return rehearsal_.prepare(*law_, now_ns_, why_);
  }

  std::int64_t now_ns_ = 1'000'000'000'000;
  std::unique_ptr<ipc::SpineMemory> spine_ = std::make_unique<ipc::SpineMemory>();
  std::unique_ptr<law::Sandbox> sandbox_ = std::make_unique<law::Sandbox>();
  std::unique_ptr<law::Resident> law_ = std::make_unique<law::Resident>();
  Rehearsal rehearsal_{*spine_, 2, 1e-3, *sandbox_};
  std::array<char, 256> why_{};
};

TEST_F(RehearsalTest, ALawLooksBackOnMoreThanASecondBeforeItStarts) {
  const Warm::State state = started(1500);
  EXPECT_EQ(state.seen, 1500u);
  EXPECT_EQ(state.joints, 2u);
  EXPECT_NEAR(state.mean_rad_s, 2, 1e-9);
  EXPECT_DOUBLE_EQ(state.newest_rad, 0.002 * 1499);
  EXPECT_NEAR(state.oldest_age_s, 1.499, 1e-9);
}

TEST_F(RehearsalTest, AFilterOverASensorNeedNotStartCold) {
  const Warm::State state = started(1500);
  EXPECT_DOUBLE_EQ(state.newest_sensor, 100 + 1499);
  EXPECT_DOUBLE_EQ(state.oldest_sensor, 100);
}

TEST_F(RehearsalTest, TheNewestTicksAreKeptWhenThereAreMoreThanFit) {
  for (const std::uint32_t count : {kMostPast - 1, kMostPast, kMostPast + 1, 2 * kMostPast, 10'000u}) {
    const Warm::State state = started(count);
    EXPECT_EQ(state.seen, std::min(count, kMostPast)) << count;
    EXPECT_DOUBLE_EQ(state.newest_rad, 0.002 * (count - 1)) << count;
    EXPECT_NEAR(state.oldest_age_s, 1e-3 * (std::min(count, kMostPast) - 1), 1e-9) << count;
    std::memset(static_cast<void*>(spine_.get()), 0, sizeof *spine_);
  }
}

TEST_F(RehearsalTest, TicksInWhichASensorWasBrokenAreNotShown) {
  live(10);
  ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> writer(spine_->telemetry);
  wire::Telemetry broken{};
  broken.release_ns = ++now_ns_;
  broken.velocity_rad_s[1] = std::nan("");
  writer.push(broken);
  EXPECT_TRUE(prepare(kWarm)) << why_.data();
  Warm::State state;
  std::memcpy(&state, law_->state.data(), sizeof state);
  EXPECT_EQ(state.seen, 10u);
  EXPECT_DOUBLE_EQ(state.newest_rad, 0.002 * 9);
}

TEST_F(RehearsalTest, ARobotThatHasJustStartedHasNoPast) { EXPECT_EQ(started(0).seen, 0u); }

TEST_F(RehearsalTest, AStepThatIsNotFiniteIsRefusedWithItsName) {
  EXPECT_FALSE(prepare(kBadStep));
  EXPECT_STREQ(why_.data(), "torque_nm[0] is not finite in dry step 0");
}

TEST_F(RehearsalTest, AStartThatCrashesIsRefused) {
  if (contain::kReportsFaults) GTEST_SKIP() << "the sanitizer wants SIGSEGV for itself";
  contain::FaultBarrier barrier = contain::open_barrier();
  rehearsal_.use(&barrier);
  EXPECT_FALSE(prepare(kBadStart));
  EXPECT_STREQ(why_.data(), "init failed before its first tick: bad_access");
  EXPECT_EQ(started(3).seen, 3u) << "and the next one starts as if nothing had happened";
}

}  // namespace
}  // namespace lithe::load
