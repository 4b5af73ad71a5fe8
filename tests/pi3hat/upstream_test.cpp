// SPDX-License-Identifier: Apache-2.0
// The file that calls the maker's library, over a board of ours that writes down what it is told.
#include <gtest/gtest.h>
#include <mjbots/pi3hat/pi3hat.h>

#include <array>
#include <string>
#include <vector>

#include "spine/hal/bus/pi3hat/pi3hat_port.hpp"
#include "spine/hal/open_bus.hpp"

namespace lithe::hal {
namespace {

using mjbots::pi3hat::Notes;
using mjbots::pi3hat::notes;

class Upstream : public testing::Test {
 protected:
  void SetUp() override { notes() = Notes{}; }
  Pi3hatOutcome cycle(const Pi3hatOrder& order, std::size_t room = 160) {
    auto opened = open_pi3hat_port({});
    EXPECT_TRUE(opened) << opened.message();
    received_.resize(room);
    return (*opened)->cycle(order, received_, attitude_);
  }
  std::vector<Pi3hatFrame> received_;
  Pi3hatAttitude attitude_;
};

TEST_F(Upstream, AConnectorThatNobodyUsesOnlyListens) {
  std::vector<robot::BusConfig> buses(2);
  for (robot::BusConfig& bus : buses) bus.kind = robot::BusKind::pi3hat;
  buses[0].connector = 1;
  buses[1].connector = 4;
  buses[1].data_bitrate = 0;
  const auto opened = BusOpener(buses, true).open(buses[0]);
  ASSERT_TRUE(opened) << opened.message();
  const auto& can = notes().configuration.can;
  for (std::size_t i = 0; i < kPi3hatConnectors; ++i) EXPECT_EQ(can[i].bus_monitor, i != 0 && i != 3) << i;
  EXPECT_TRUE(can[0].fdcan_frame);
  EXPECT_FALSE(can[3].fdcan_frame);
}

TEST_F(Upstream, AnAwaitedAnswerIsWaitedForAsLongAsOneTakes) {
  std::array<Pi3hatFrame, 2> frames{};
  frames[0].connector = 1;
  frames[0].answered = true;
  frames[1].connector = 2;
  cycle({frames, 6, 300'000, false});
  ASSERT_EQ(notes().sent.size(), 2U);
  EXPECT_TRUE(notes().sent[0].expect_reply);
  EXPECT_EQ(notes().sent[0].expected_reply_size, 24);
  EXPECT_FALSE(notes().sent[1].expect_reply);
  EXPECT_EQ(notes().input.rx_baseline_wait_ns, 300'000U);
}

TEST_F(Upstream, WithoutRoomNothingIsReadAndWithoutCommandsNothingIsWaitedFor) {
  notes().arrives.resize(3);
  EXPECT_EQ(cycle({{}, 6, 300'000, false}, 0).received, 0U);
  EXPECT_EQ(notes().room, 0U);
  EXPECT_EQ(cycle({{}, 6, 300'000, false}).received, 3U);
  EXPECT_EQ(notes().input.min_tx_wait_ns, 0U);
  EXPECT_EQ(notes().input.rx_baseline_wait_ns, 0U);
}

TEST_F(Upstream, ABoardThatCannotBeHadIsRefusedWithTheReason) {
  notes().can_unknown_address_safe = false;
  auto opened = open_pi3hat_port({});
  ASSERT_FALSE(opened);
  EXPECT_NE(opened.message().find("firmware"), std::string::npos);
  notes().absent = true;
  opened = open_pi3hat_port({});
  ASSERT_FALSE(opened);
  EXPECT_NE(opened.message().find("no board"), std::string::npos);
}

}  // namespace
}  // namespace lithe::hal
