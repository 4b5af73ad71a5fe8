// SPDX-License-Identifier: Apache-2.0
// The terminal against simulated drives, and against silence.
#include "spine/hal/moteus/moteus_terminal.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <random>
#include <vector>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"

namespace lithe::hal::moteus {
namespace {

class House {
 public:
  explicit House(std::vector<std::uint32_t> ids) {
    for (const std::uint32_t id : ids) {
      sim::SimMoteusParams params;
      params.id = id;
      params.serial = drives_.size() + 1;
      drives_.push_back(std::make_unique<sim::SimMoteus>(params));
      bus_.attach(*drives_.back());
    }
  }
  Terminal terminal() {
    return Terminal(bus_, {[this] { return now_ns_; }, [this] { now_ns_ += 1'000'000; }});
  }

 private:
  std::vector<std::unique_ptr<sim::SimMoteus>> drives_;
  LoopBus bus_;
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST(MoteusTerminal, FindsEveryDriveEvenTwoWithOneId) {
  House house({9, 3, 9});
  const auto found = house.terminal().discover();
  ASSERT_EQ(found.size(), 3U);
  EXPECT_EQ(found[0].id, 3U);
  EXPECT_EQ(found[1].id, 9U);
  EXPECT_EQ(found[2].id, 9U);
  EXPECT_EQ(found[0].uuid, sim::MoteusIdentity::of(2).uuid);
  EXPECT_NE(found[1].uuid, found[2].uuid);
  EXPECT_TRUE(found[0].maskable);
  EXPECT_TRUE(House({}).terminal().discover().empty());
}

TEST(MoteusTerminal, TheQuestionToAllIsTheMakersFrame) {
  Frame frame;
  make_discovery(frame);
  const std::array<std::uint8_t, 7> golden{0x18, 0x04, 0xd0, 0x02, 0x11, 0xd8, 0x02};
  EXPECT_EQ(frame.id, 0x807fU);
  EXPECT_TRUE(std::equal(golden.begin(), golden.end(), frame.data.begin()));
}

// Says that it has map 5 for ever; time passes only with each look at it.
class Babble final : public Bus {
 public:
  explicit Babble(bool to_whoever_asks) : to_whoever_asks_(to_whoever_asks) {
    said_.id = 4U << 8;
    SubframeWriter(said_).reply(Format::int32, reg::kRegisterMap, std::array{5.0}, false);
  }
  void begin(std::int64_t /*now_ns*/) LITHE_RT override {}
  bool send(const Frame& frame) LITHE_RT override {
    source_ = to_whoever_asks_ ? frame.id >> 8 & 0x7f : 0;
    return true;
  }
  bool receive(Frame& frame) LITHE_RT override {
    frame = said_;
    frame.id |= source_;
    return true;
  }
  Terminal terminal() {
    return Terminal(*this, {[this] { return now_ns_ += 5'000'000; }, [] {}});
  }

 private:
  Frame said_;
  bool to_whoever_asks_;
  std::uint32_t source_ = 0;
  std::int64_t now_ns_ = 0;
};

TEST(MoteusTerminal, ABusOnWhichSomebodyAlwaysTalksIsGivenUp) {
  Babble other(false);
  EXPECT_FALSE(other.terminal().discover().empty());
  EXPECT_EQ(other.terminal().identify({.id = 5}).message(), "drive 5 does not answer");
}

TEST(MoteusTerminal, WhatAnswersAnEarlierQuestionIsPassedOver) {
  EXPECT_EQ(Babble(false).terminal().identify({.id = 4}).message(), "drive 4 does not answer");
  EXPECT_EQ(Babble(true).terminal().identify({.id = 4})->register_map, 5U);
}

TEST(MoteusTerminal, NonsenseIsNoDiscovery) {
  std::mt19937_64 random(9);
  int accepted = 0;
  for (int round = 0; round < 50'000; ++round) {
    Found found;
    Frame frame;
    frame.id = static_cast<std::uint32_t>(random() % 0x10000) & (round % 4 == 0 ? 0xffffU : 0x7f00U);
    frame.size = static_cast<std::uint8_t>(random() % 65);
    for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random() % (round % 2 == 0 ? 256 : 90));
    if (!parse_discovery(frame, found)) {
      ASSERT_EQ(found.id, 0U) << "unchanged";
      continue;
    }
    ++accepted;
    ASSERT_TRUE(found.id >= 1 && found.id <= 126) << found.id;
  }
  EXPECT_GT(accepted, 100) << "or it shows nothing";
}

}  // namespace
}  // namespace lithe::hal::moteus
