// SPDX-License-Identifier: Apache-2.0
// The terminal against simulated drives, and against silence.
#include "spine/hal/moteus/moteus_terminal.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <random>
#include <string>
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
  sim::SimMoteus& drive(std::size_t i) { return *drives_[i]; }

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
  EXPECT_EQ(found[0].uuid, house.drive(1).identity().uuid);
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

TEST(MoteusTerminal, ReadsSetsAndStoresSettings) {
  House house({4});
  Terminal terminal = house.terminal();
  EXPECT_EQ(*terminal.setting(4, "servo.pid_position.kp"), "4.000000");
  EXPECT_TRUE(terminal.set(4, "servo.pid_position.kp", "2.5"));
  EXPECT_EQ(*terminal.setting(4, "servo.pid_position.kp"), "2.500000");
  EXPECT_EQ(*terminal.command(4, "conf write"), "");
  const std::string all = *terminal.command(4, "conf enumerate");
  EXPECT_NE(all.find("servo.pid_position.kp 2.500000\n"), std::string::npos);
  EXPECT_EQ(all.substr(0, 8), "id.id 4\n");
}

TEST(MoteusTerminal, TellsWhatTheDriveObjectsTo) {
  House house({4});
  Terminal terminal = house.terminal();
  EXPECT_EQ(terminal.setting(4, "servo.nothing").message(),
            "drive 4 answers to 'conf get servo.nothing': ERR error reading");
  EXPECT_EQ(terminal.set(4, "id.id", "200").message(), "drive 4 answers to 'conf set id.id 200': ERR error setting");
  EXPECT_EQ(terminal.command(5, "d stop").message(), "drive 5 does not answer");
}

TEST(MoteusTerminal, WhatNobodyFetchedBeforeIsNotTakenForTheAnswer) {
  House house({4});
  Terminal terminal = house.terminal();
  EXPECT_EQ(*terminal.command(4, "tel stop\nconf get id.id"), "");  // leaves a line behind
  EXPECT_EQ(*terminal.setting(4, "servo.default_timeout_s"), "0.100000");
}

// Says the same for ever, but that it has nothing to say from before; time passes only with each look at it.
class Babble final : public Bus {
 public:
  Babble(std::string_view text, bool to_whoever_asks) : to_whoever_asks_(to_whoever_asks) {
    old_.id = said_.id = 4U << 8;
    SubframeWriter(old_).server_data(1, {});
    SubframeWriter(said_).server_data(1, {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()});
  }
  void begin(std::int64_t /*now_ns*/) LITHE_RT override {}
  bool send(const Frame& frame) LITHE_RT override {
    source_ = to_whoever_asks_ ? frame.id >> 8 & 0x7f : 0;
    ++asked_;
    return true;
  }
  bool receive(Frame& frame) LITHE_RT override {
    frame = asked_ == 1 ? old_ : said_;
    frame.id |= source_;
    return true;
  }
  Terminal terminal() {
    return Terminal(*this, {[this] { return now_ns_ += 5'000'000; }, [] {}});
  }

 private:
  Frame old_, said_;
  bool to_whoever_asks_;
  std::uint32_t source_ = 0;
  int asked_ = 0;
  std::int64_t now_ns_ = 0;
};

TEST(MoteusTerminal, ABusOnWhichSomebodyAlwaysTalksIsGivenUp) {
  Babble stranger("hello", false);
  EXPECT_TRUE(stranger.terminal().discover().empty());
  EXPECT_EQ(stranger.terminal().command(4, "d stop").message(), "drive 4 does not answer");
}

TEST(MoteusTerminal, ADriveThatNeverFinishesItsAnswerIsGivenUp) {
  Babble drive("and more and ", true);
  EXPECT_EQ(drive.terminal().command(4, "tel list").message(), "drive 4 does not finish its answer to 'tel list'");
}

TEST(MoteusTerminal, WhatAnswersAnEarlierQuestionIsPassedOver) {
  Babble late("OK\n", false);
  EXPECT_EQ(late.terminal().command(4, "d stop").message(), "drive 4 does not answer");
  Babble prompt("OK\n", true);
  EXPECT_TRUE(prompt.terminal().command(4, "d stop"));
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
    if (!take_discovery(frame, found)) {
      ASSERT_EQ(found.id, 0U) << "unchanged";
      continue;
    }
    ++accepted;
    ASSERT_TRUE(found.id >= 1 && found.id <= 126) << found.id;
  }
  EXPECT_GT(accepted, 100) << "or it shows nothing";
}

// Answers in the very frame that says the words.
class Prompt final : public BusNode {
 public:
  void on_frame(const Frame& frame, std::int64_t, FrameQueue& answers) LITHE_RT override {
    SubframeReader reader(frame.payload());
    Subframe s;
    const bool spoken_to = reader.next(s) && s.kind == Kind::client_data;
    constexpr std::array<std::uint8_t, 4> kSaid{'O', 'K', '\r', '\n'};
    Frame answer;
    answer.id = 4U << 8 | (frame.id >> 8 & 0x7f);
    SubframeWriter writer(answer);
    writer.server_data(1, {kSaid.data(), spoken_to ? kSaid.size() : 0});
    answers.push(answer);
  }
};

TEST(MoteusTerminal, ADriveMayAnswerInTheFrameThatAsksIt) {
  Prompt prompt;
  LoopBus bus;
  bus.attach(prompt);
  std::int64_t now_ns = 0;
  Terminal terminal(bus, {[&] { return now_ns; }, [&] { now_ns += 1'000'000; }});
  EXPECT_TRUE(terminal.command(4, "d stop"));
}

}  // namespace
}  // namespace lithe::hal::moteus
