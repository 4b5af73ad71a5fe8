// SPDX-License-Identifier: Apache-2.0
// The driver of a CiA 401 module, against the simulated module.
#include "spine/hal/cia401/cia401_module.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "spine/hal/cia401/sim/sim_cia401.hpp"

namespace lithe::hal::cia401 {
namespace {

constexpr std::uint32_t kNode = 5;

class Cia401Module : public testing::Test {
 protected:
  Cia401Module() { bus_.attach(sim_); }

  // `take`: false drops a frame of the module.
  void cycle(int times, bool (*take)(Frame&) = nullptr) {
    for (int i = 0; i < times; ++i) {
      now_ns_ += kMs;
      bus_.begin(now_ns_);
      module_.step({.number = ++number_, .now_ns = now_ns_}, bus_);
      Frame frame;
      while (bus_.receive(frame)) {
        if (take != nullptr && !take(frame)) continue;
        if (module_.sent(frame)) module_.on_frame(frame, now_ns_);
      }
    }
  }
  bool read(Block block, std::size_t channel, double& raw) const { return module_.read(block, channel, now_ns_, raw); }
  bool valid() const {
    double raw = 0;
    return read(Block::digital, 0, raw) && read(Block::analog, 0, raw);
  }

  static constexpr ModuleParams kParams{.id = kNode, .inputs = {16, 6}};
  sim::SimCia401 sim_{kNode, {16, 6}};
  Module module_{kParams};
  LoopBus bus_;
  std::int64_t now_ns_ = 1000 * kMs;
  std::uint64_t number_ = 0;
};

TEST_F(Cia401Module, IsSetUpAndMeasures) {
  cycle(200);
  ASSERT_TRUE(module_.running());
  EXPECT_EQ(module_.why_not_ready(), "");
  EXPECT_EQ(sim_.state(), canopen::NmtState::operational);
  EXPECT_EQ(sim_.objects().value(0x1800, 5), 10U) << "event timer [ms]";
  EXPECT_EQ(sim_.objects().value(0x6423, 0), 1U);
  double first = 0, sixth = 0, bit = -1;
  ASSERT_TRUE(read(Block::analog, 0, first) && read(Block::analog, 5, sixth) && read(Block::digital, 15, bit));
  // Both swing with the same period; five radians lie between them.
  EXPECT_LE(std::abs(first), 1000);
  const double time_rad = std::asin(first / 1000);
  const double one = 1000 * std::sin(time_rad + 5), other = 1000 * std::sin(std::numbers::pi - time_rad + 5);
  EXPECT_LT(std::min(std::abs(sixth - one), std::abs(sixth - other)), 20);
  EXPECT_TRUE(bit == 0 || bit == 1);
  EXPECT_EQ(module_.malformed(), 0U);
}

TEST_F(Cia401Module, HasNoChannelsBeyondThoseItWasGiven) {
  cycle(200);
  double raw = 7;
  EXPECT_FALSE(read(Block::analog, 6, raw));
  EXPECT_FALSE(read(Block::digital, 16, raw));
  EXPECT_FALSE(read(Block::imu, 0, raw));
  EXPECT_EQ(raw, 7);
}

TEST_F(Cia401Module, OldValuesAreNotValid) {
  cycle(200);
  ASSERT_TRUE(valid());
  const auto no_inputs = [](Frame& frame) {
    const std::uint32_t function = canopen::function_of(frame);
    return function < canopen::cob::kTpdo1 || function >= canopen::cob::kSdoAnswer;
  };
  cycle(90, no_inputs);
  EXPECT_TRUE(valid());
  cycle(30, no_inputs);
  EXPECT_FALSE(valid());
  EXPECT_TRUE(module_.running()) << "its heartbeat goes on";
}

TEST_F(Cia401Module, ALostHeartbeatIsToldAndTheModuleIsSetUpWhenItIsBack) {
  cycle(200);
  sim_.mute(true);
  cycle(400);
  EXPECT_FALSE(module_.running());
  EXPECT_FALSE(valid());
  EXPECT_NE(module_.why_not_ready().find("heartbeat"), std::string::npos) << module_.why_not_ready();
  cycle(5000);
  EXPECT_NE(module_.why_not_ready().find("does not report back"), std::string::npos) << module_.why_not_ready();
  sim_.mute(false);
  cycle(5300);
  EXPECT_TRUE(valid());
  EXPECT_EQ(module_.why_not_ready(), "");
}

TEST_F(Cia401Module, AModuleThatBootsAgainIsSetUpAgain) {
  cycle(200);
  sim_.inject(InjectedFault::power_loss, true, now_ns_);
  cycle(100);
  EXPECT_EQ(sim_.objects().value(0x1017, 0), 0U) << "it forgot its settings";
  cycle(200);
  EXPECT_TRUE(module_.running());
  EXPECT_TRUE(valid());
  EXPECT_EQ(sim_.objects().value(0x1017, 0), 100U);
}

TEST_F(Cia401Module, ProcessDataOfAWrongLengthIsCountedAndNotUsed) {
  cycle(200);
  sim_.inject(InjectedFault::other_map, true, now_ns_);
  cycle(150);
  EXPECT_FALSE(valid());
  EXPECT_GT(module_.malformed(), 10U);
  sim_.inject(InjectedFault::other_map, false, now_ns_);
  cycle(20);
  EXPECT_TRUE(valid());
}

TEST_F(Cia401Module, AModuleThatFallsBackIsStartedAgain) {
  cycle(500);
  for (const auto state : {canopen::NmtState::pre_operational, canopen::NmtState::stopped}) {
    sim_.fall_back(state);
    for (int i = 0; i < 110 && module_.why_not_ready().empty(); ++i) cycle(1);
    EXPECT_NE(module_.why_not_ready(), "") << "its heartbeat tells it";
    cycle(500);
    EXPECT_TRUE(valid());
    EXPECT_EQ(module_.why_not_ready(), "");
  }
}

TEST_F(Cia401Module, AnotherProfileIsRefusedAndNamed) {
  cycle(200, [](Frame& frame) {
    const bool type = canopen::function_of(frame) == canopen::cob::kSdoAnswer &&
                      canopen::sdo_address(frame) == canopen::Address{0x1000, 0};
    if (type) put_little_endian(frame.data.data() + 4, 0x0002'0192, 4);
    return true;
  });
  EXPECT_FALSE(module_.running());
  EXPECT_NE(module_.why_not_ready().find("profile is 402"), std::string::npos) << module_.why_not_ready();
}

TEST_F(Cia401Module, InputsThatTheModuleLacksAreNamed) {
  sim::SimCia401 small(kNode, {8, 0});
  LoopBus bus;
  bus.attach(small);
  Module module(kParams);
  for (int i = 0; i < 200; ++i) {
    now_ns_ += kMs;
    bus.begin(now_ns_);
    module.step({.number = ++number_, .now_ns = now_ns_}, bus);
    Frame frame;
    while (bus.receive(frame)) module.on_frame(frame, now_ns_);
  }
  EXPECT_NE(module.why_not_ready().find("object 1A00h:02: no such object"), std::string::npos)
      << module.why_not_ready();
}

TEST_F(Cia401Module, AFrameOfAnotherNodeIsNotItsOwn) {
  EXPECT_TRUE(module_.sent(canopen::heartbeat_frame(kNode, canopen::NmtState::operational)));
  EXPECT_FALSE(module_.sent(canopen::heartbeat_frame(kNode + 1, canopen::NmtState::operational)));
  EXPECT_FALSE(module_.sent(canopen::sync_frame()));
}

}  // namespace
}  // namespace lithe::hal::cia401
