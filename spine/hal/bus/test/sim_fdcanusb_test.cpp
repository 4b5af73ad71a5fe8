// SPDX-License-Identifier: Apache-2.0
// What a host sees of the adapter: lines, refusals, checksums, nonsense.
#include "spine/hal/bus/fdcanusb/sim_fdcanusb.hpp"

#include <gtest/gtest.h>

#include <random>
#include <string>

#include "spine/hal/moteus/test/sim_rig.hpp"

namespace lithe::hal::sim {
namespace {

std::string summed(std::string_view line) {
  std::array<char, fdcanusb::kLongestLine> out{};
  line.copy(out.data(), line.size());
  return {out.data(), fdcanusb::append_sum(out, line.size())};
}

class Line {
 public:
  Line() : drive_(bench_motor()) { adapter_.attach(drive_); }
  std::string say(std::string_view text) {
    std::string out;
    adapter_.feed({text.data(), text.size()}, now_ns_, out);
    return out;
  }
  void idle() {
    std::string out;
    adapter_.idle(now_ns_, out);
  }
  SimFdcanusb& adapter() { return adapter_; }

 private:
  SimMoteus drive_;
  SimFdcanusb adapter_;
  std::int64_t now_ns_ = 1'000 * kMs;
};

constexpr std::string_view kQuery = "can send 8001 11001F01130D BF\n";
TEST(SimFdcanusb, AQueryIsAcknowledgedAndAnswered) {
  Line line;
  const std::string answer = line.say(kQuery);
  EXPECT_EQ(answer, "OK\r\nrcv 0100 2100002F01000000000000000000000000230D3019005050 e B F r x-1\r\n");
}

TEST(SimFdcanusb, LinesMayComeInPiecesAndWithAnyEnd) {
  Line line;
  const std::string whole = line.say(kQuery);
  EXPECT_EQ(line.say("can send 8001 1100"), "");
  EXPECT_EQ(line.say("1F01130D BF"), "");
  EXPECT_EQ(line.say("\r\n\n\r"), whole);
}

TEST(SimFdcanusb, ChecksumsAreGivenAndDemandedAfterTheFirst) {
  Line line;
  EXPECT_EQ(line.say("can status\n").substr(0, 4), "lec=");
  EXPECT_EQ(line.say(summed("can status") + "\n"), summed("lec=0 dlec=0 err=0 warn=0 busoff=0 pexc=0 tdc=13") + "\r\n");
  EXPECT_EQ(line.say("can status\n"), summed("ERR checksum") + "\r\n");
  line.adapter().reset();
  EXPECT_EQ(line.say("can status\n").substr(0, 4), "lec=");
  EXPECT_EQ(line.say("can status *00\n"), "ERR checksum\r\n");
}

TEST(SimFdcanusb, OffIsOff) {
  Line line;
  EXPECT_EQ(line.say("can on\n"), "ERR already in BusOn\r\n");
  EXPECT_EQ(line.say("can off\n"), "OK\r\n");
  EXPECT_EQ(line.say("can off\n"), "ERR already in BusOff\r\n");
  EXPECT_EQ(line.say(kQuery), "ERR not in BusOn state\r\n");
  EXPECT_EQ(line.say("can config\n"), "ERR not in BusOn\r\n");
  EXPECT_EQ(line.say("can on\n"), "OK\r\n");
  EXPECT_EQ(line.say("can config\n").substr(0, 13), "clk=85000000 ");
}

TEST(SimFdcanusb, ABusOffLastsUntilItIsSwitchedOffAndOnOrRecoversByItself) {
  Line line;
  const auto answers = [&] { return line.say(kQuery).find("rcv") != std::string::npos; };
  line.adapter().set_bus_off(true);
  EXPECT_EQ(line.say(kQuery), "OK\r\n") << "it takes commands, as if nothing were";
  EXPECT_NE(line.say("can status\n").find(" busoff=1 "), std::string::npos);
  line.say("can off\ncan on\n");
  EXPECT_NE(line.say("can status\n").find(" busoff=1 "), std::string::npos) << "the wires are as bad as before";
  line.adapter().set_bus_off(false);
  line.idle();
  EXPECT_FALSE(answers());
  line.say("can off\ncan on\n");
  EXPECT_TRUE(answers());
  EXPECT_NE(line.say("can status\n").find(" busoff=0 "), std::string::npos);
  line.say("conf set can.autorecover 1\n");
  line.adapter().set_bus_off(true);
  line.idle();
  EXPECT_FALSE(answers());
  line.adapter().set_bus_off(false);
  line.idle();
  EXPECT_TRUE(answers());
}

TEST(SimFdcanusb, SettingsAreReadWrittenStoredAndBroughtBack) {
  Line line;
  EXPECT_EQ(line.say("conf get can.bitrate\n"), "1000000\r\n");
  EXPECT_EQ(line.say("conf get can.sample_point\n"), "0.666\r\n");
  EXPECT_EQ(line.say("conf get can.nothing\n"), "ERR error reading\r\n");
  EXPECT_EQ(line.say("conf get dog.bitrate\n"), "ERR unknown group\r\n");
  EXPECT_EQ(line.say("conf set can.cancel_all_ms 5\n"), "OK\r\n");
  EXPECT_EQ(line.say("conf get can.cancel_all_ms\n"), "5\r\n");
  EXPECT_EQ(line.say("conf load\nconf get can.cancel_all_ms\n"), "OK\r\n50\r\n");
  EXPECT_EQ(line.say("conf set can.cancel_all_ms 5x\n"), "ERR error setting\r\n");
  EXPECT_EQ(line.say("conf jump\n"), "ERR unknown subcommand\r\n");
  const std::string all = line.say("conf enumerate\n");
  EXPECT_EQ(all.substr(0, 21), "can.bitrate 1000000\r\n");
  EXPECT_EQ(all.substr(all.size() - 4), "OK\r\n");
}

TEST(SimFdcanusb, TheDefaultsOfASendAreSettings) {
  Line line;
  EXPECT_NE(line.say("can send 8001 1100\n").find(" e B F "), std::string::npos);
  line.say("conf set can.fdcan_frame 0\n");
  EXPECT_NE(line.say("can send 8001 1100\n").find(" e b f "), std::string::npos);
}

TEST(SimFdcanusb, WhatIsTooLongIsPassedOverAndTheNextLineIsServed) {
  Line line;
  EXPECT_EQ(line.say(std::string(100'000, 'a')), "");
  EXPECT_EQ(line.say("\ncan off\n"), "OK\r\n");
  EXPECT_EQ(line.say("can jump\nhello\n"), "ERR unknown subcommand\r\nERR unknown command\r\n");
}

TEST(SimFdcanusb, GarbageNeverBreaksIt) {
  Line line;
  std::mt19937_64 random(6);
  constexpr std::string_view kLetters = "can sendfgt01ABF.*\n\r\0\xff";
  for (int round = 0; round < 20'000; ++round) {
    std::string text = round % 2 == 0 ? std::string(kQuery) : std::string("conf set can.bitrate 5\n");
    for (int i = 0; i < 3; ++i) text[random() % text.size()] = kLetters[random() % kLetters.size()];
    for (const char c : line.say(text)) ASSERT_TRUE(c == '\r' || c == '\n' || (c >= ' ' && c < 127));
  }
}

}  // namespace
}  // namespace lithe::hal::sim
