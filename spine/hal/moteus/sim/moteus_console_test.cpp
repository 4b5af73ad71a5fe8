// SPDX-License-Identifier: Apache-2.0
// The console as a host reaches it: through stream subframes.
#include "spine/hal/moteus/sim/moteus_console.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "spine/hal/bus/serial/words.hpp"
#include "spine/hal/moteus/test/sim_rig.hpp"

namespace lithe::hal::sim {
namespace {

class Terminal : public Bench {
 public:
  Terminal() { wait_ms(1); }

  // Types it in pieces of at most 40 bytes; all that comes back.
  std::string type(std::string_view text) {
    while (!text.empty()) {
      const std::string_view piece = text.substr(0, 40);
      text.remove_prefix(piece.size());
      Frame frame = blank();
      SubframeWriter writer(frame);
      writer.client_data(1, {reinterpret_cast<const std::uint8_t*>(piece.data()), piece.size()});
      const Frame answer = send(frame)[0];
      EXPECT_EQ(answer.data[0], 0x41);
      EXPECT_EQ(answer.data[2], 0);
    }
    return rest();
  }

  std::string rest() {
    std::string all;
    while (true) {
      Frame frame = blank();
      SubframeWriter writer(frame);
      writer.poll(1, 48);
      const Frame answer = send(frame)[0];
      SubframeReader reader(answer.payload());
      Subframe s;
      EXPECT_TRUE(reader.next(s) && s.kind == Kind::server_data && s.count <= 48);
      if (s.count == 0) return all;
      all.append(reinterpret_cast<const char*>(s.data), s.count);
    }
  }

 private:
  static Frame blank() {
    Frame frame;
    frame.id = 0x8001;
    frame.extended = frame.fd = true;
    return frame;
  }
};

TEST(Numbers, ReadWhatPeopleType) {
  const std::pair<std::string_view, double> good[] = {{"0", 0},
                                                      {"-1.5", -1.5},
                                                      {"+.25", .25},
                                                      {"1e3", 1000},
                                                      {"1.5E-2", .015},
                                                      {"26e-6", 26e-6},
                                                      {"5.", 5},
                                                      {"1e999", INFINITY},
                                                      {"-inf", -INFINITY},
                                                      {"0e999", 0},
                                                      {"123456789012345678901", 123456789012345678901.0}};
  for (const auto& [text, expected] : good) {
    double value = 7;
    EXPECT_TRUE(read_number(text, value)) << text;
    if (std::isfinite(expected))
      EXPECT_NEAR(value, expected, 1e-12 * std::abs(expected)) << text;
    else
      EXPECT_EQ(value, expected) << text;
  }
  double value = 7;
  EXPECT_TRUE(read_number("NaN", value) && std::isnan(value));
  value = 7;
  for (const char* bad : {"", "-", ".", "1x", "1e", "--1", "1 ", "0x10", "1.2.3", "nano"})
    EXPECT_FALSE(read_number(bad, value)) << bad;
  EXPECT_EQ(value, 7);
}

TEST(Numbers, WriteSixDigitsOrNone) {
  const auto written = [](double value, bool integer) {
    std::array<char, kLongestNumber> out{};
    return std::string(out.data(), write_number(value, integer, out));
  };
  EXPECT_EQ(written(4, false), "4.000000");
  EXPECT_EQ(written(-0.05, false), "-0.050000");
  EXPECT_EQ(written(0.9999999, false), "1.000000");
  EXPECT_EQ(written(26e-6, false), "0.000026");
  EXPECT_EQ(written(12, true), "12");
  EXPECT_EQ(written(NAN, false), "nan");
  EXPECT_EQ(written(-INFINITY, false), "-inf");
  EXPECT_EQ(written(1e300, false), "1000000000000000.000000");
  std::array<char, 3> tight{};
  EXPECT_EQ(write_number(1234, true, tight), 0U);
}

TEST(MoteusConsole, SettingsAreReadSetAndListed) {
  Terminal t;
  EXPECT_EQ(t.type("conf get servo.pid_position.kp\n"), "4.000000\r\n");
  EXPECT_EQ(t.type("conf set servo.pid_position.kp 2.5\n"), "OK\r\n");
  EXPECT_EQ(t.drive().servo().params().kp_nm_rev, 2.5);
  EXPECT_EQ(t.type("conf get servopos.position_min\n"), "nan\r\n");
  EXPECT_EQ(t.type("conf get id.id\n"), "1\r\n");
  EXPECT_EQ(t.type("conf get dog.id\n"), "ERR unknown group\r\n");
  EXPECT_EQ(t.type("conf get id.dog\n"), "ERR error reading\r\n");
  EXPECT_EQ(t.type("conf set id.id 127\nconf set id.id x\nconf set id.dog 1\n"),
            "ERR error setting\r\nERR error setting\r\nERR error setting\r\n");
  const std::string all = t.type("conf enumerate\n");
  EXPECT_EQ(all.substr(0, 9), "id.id 1\r\n");
  EXPECT_NE(all.find("servo.pid_position.kp 2.500000\r\n"), std::string::npos);
  EXPECT_EQ(all.substr(all.size() - 4), "OK\r\n");
  EXPECT_EQ(t.type("conf enumerate servopos\n"), "servopos.position_min nan\r\nservopos.position_max nan\r\nOK\r\n");
  EXPECT_EQ(t.type("conf enumerate dog\n"), "ERR unknown group\r\n");
  EXPECT_EQ(t.type("conf enumerate uuid\n").substr(0, 12), "uuid.uuid.0 ");
}

TEST(MoteusConsole, WhatIsNotWrittenIsForgottenByARestart) {
  Terminal t;
  t.type("conf set servo.pid_position.kp 2\nconf write\nconf set servo.pid_position.kp 3\n");
  EXPECT_EQ(t.type("conf load\nconf get servo.pid_position.kp\n"), "OK\r\n2.000000\r\n");
  t.type("conf set servo.pid_position.kp 3\n");
  t.drive().restart(0);
  EXPECT_EQ(t.drive().servo().params().kp_nm_rev, 2);
  EXPECT_EQ(t.type("conf default\nconf get servo.pid_position.kp\n"), "OK\r\n4.000000\r\n");
}

TEST(MoteusConsole, ANewIdIsTheDrivesFromThenOn) {
  Terminal t;
  Frame other = Bench::request({}, {reg::kPosition}, 0x8009);
  EXPECT_TRUE(t.send(other).empty());
  std::string command = "conf set id.id 9\n";
  Frame frame = Bench::request({}, {}, 0x8001);
  SubframeWriter writer(frame);
  writer.client_data(1, {reinterpret_cast<const std::uint8_t*>(command.data()), command.size()});
  t.send(frame);
  EXPECT_EQ(t.send(other).size(), 1U);
  EXPECT_TRUE(t.send(Bench::request({}, {reg::kPosition}, 0x8001)).empty());
}

TEST(MoteusConsole, BoundsThatAreSetHold) {
  Terminal t;
  t.type("conf set servopos.position_max 0.1\nconf set servopos.position_min -0.1\n");
  t.drive().servo().plant().place(0.5 * kTurn);
  t.wait_ms(5);
  EXPECT_EQ(t.stream(kTorque, 10).at(reg::kFault), moteus::fault::kOutsideLimit);
}

TEST(MoteusConsole, CommandsByHandMoveTheDrive) {
  Terminal t;
  EXPECT_EQ(t.type("d pos 0.25 0 0.5 p1 d1 a-1 v-1\n"), "OK\r\n");
  for (int i = 0; i < 40; ++i) t.wait_ms(50);  // by hand there is no watchdog
  EXPECT_EQ(t.mode(), Mode::position);
  EXPECT_NEAR(t.exchange({}).at(reg::kPosition), 0.25, 0.02);
  EXPECT_EQ(t.type("d stop\n"), "OK\r\n");
  EXPECT_EQ(t.mode(), Mode::stopped);
  const std::pair<const char*, Mode> modes[] = {{"d brake\n", Mode::brake},
                                                {"d stop\nd zero nan 0 nan\n", Mode::zero_velocity},
                                                {"d stop\nd within -1 1 0.2\n", Mode::stay_within},
                                                {"d stop\nd tmt nan 0 nan\n", Mode::timeout},
                                                {"d stop\nd dq 0 0.1\n", Mode::current}};
  for (const auto& [line, mode] : modes) {
    t.type(line);
    t.wait_ms(20);
    EXPECT_EQ(t.mode(), mode) << line;
  }
  EXPECT_EQ(t.type("d stop\nd exact 2\n"), "OK\r\nOK\r\n");
  EXPECT_NEAR(t.exchange({}).at(reg::kPosition), 2, 1e-3);
  EXPECT_EQ(t.type("d nearest 0\nd cfg-set-output 1\nd recapture\nd req-reindex\n"), "OK\r\nOK\r\nOK\r\nOK\r\n");
}

TEST(MoteusConsole, WhatItDoesNotUnderstandItSaysSo) {
  Terminal t;
  EXPECT_EQ(t.type("hello\n"), "ERR unknown command\r\n");
  EXPECT_EQ(t.type("d jump\n"), "ERR unknown command\r\n");
  EXPECT_EQ(t.type("d pos 1\n"), "ERR missing p/v/i\r\n");
  EXPECT_EQ(t.type("d pos 1 0 1 z5\n"), "ERR unknown option\r\n");
  EXPECT_EQ(t.type("d within 1\n"), "ERR missing min/max/t\r\n");
  EXPECT_EQ(t.type("d exact\n"), "ERR missing index value\r\n");
  EXPECT_EQ(t.type("tel get dog\n"), "ERR unknown name\r\n");
  EXPECT_EQ(t.type("tel jump\nconf jump\n"), "ERR unknown subcommand\r\nERR unknown subcommand\r\n");
  EXPECT_EQ(t.type("\r\n \n"), "");
  EXPECT_EQ(t.type(std::string(1000, 'x') + "\nd stop\n"), "OK\r\n");
}

// The binary record behind "emit NAME\r\n" or "schema NAME\r\n".
std::string blob(const std::string& answer, const std::string& head) {
  EXPECT_EQ(answer.substr(0, head.size()), head);
  std::uint32_t size = 0;
  for (int i = 3; i >= 0; --i)
    size = size << 8 | static_cast<std::uint8_t>(answer[head.size() + static_cast<std::size_t>(i)]);
  EXPECT_EQ(answer.size(), head.size() + 4 + size);
  return answer.substr(head.size() + 4);
}

TEST(MoteusConsole, RecordsComeWithTheirSchemas) {
  Terminal t;
  EXPECT_EQ(t.type("tel list\n"), "git\r\nfirmware\r\nservo_stats\r\nsystem_info\r\nOK\r\n");
  const std::string schema = blob(t.type("tel schema firmware\n"), "schema firmware\r\n");
  EXPECT_EQ(schema.substr(0, 12), std::string("\x10\0\0\7version", 11) + std::string("\0", 1));
  EXPECT_EQ(schema.substr(schema.size() - 5), std::string(5, '\0'));
  const std::string data = blob(t.type("tel get firmware\n"), "emit firmware\r\n");
  EXPECT_EQ(data.size(), 4U + 12 + 4 + 1 + 1);
  EXPECT_EQ(data.substr(0, 4), std::string("\0\0\1\0", 4));
  EXPECT_EQ(blob(t.type("tel get git\n"), "emit git\r\n").size(), 29U);
  EXPECT_EQ(blob(t.type("tel get servo_stats\n"), "emit servo_stats\r\n").size(), 5U + 12 * 4 + 1);
}

TEST(MoteusConsole, RecordsComeByThemselvesUntilStopped) {
  Terminal t;
  EXPECT_EQ(t.type("tel text\ntel rate servo_stats 10\n").substr(0, 8), "OK\r\nOK\r\n");
  t.rest();
  t.wait_ms(10);
  EXPECT_EQ(t.rest().substr(0, 17), "servo_stats.mode ");
  EXPECT_EQ(t.rest(), "");
  t.wait_ms(10);
  EXPECT_NE(t.rest(), "");
  t.type("tel stop\n");
  t.wait_ms(50);
  EXPECT_EQ(t.rest(), "");
}

TEST(MoteusConsole, WhatNobodyFetchesIsDroppedAndTheConsoleGoesOn) {
  MoteusConsole console;
  const SimMoteusParams params = bench_motor();
  MoteusInside inside(params.servo, params.joint, params.plant, params.errors, 1, 0);
  constexpr std::string_view kLine = "conf enumerate\n";
  for (int i = 0; i < 100; ++i)
    console.feed({reinterpret_cast<const std::uint8_t*>(kLine.data()), kLine.size()}, inside);
  EXPECT_GT(console.lost(), 0U);
  std::array<std::uint8_t, 100> out{};
  std::size_t total = 0;
  while (const std::size_t count = console.fetch(out, inside)) total += count;
  EXPECT_EQ(total, MoteusConsole::kCapacity);
}

TEST(MoteusConsole, RandomLinesNeverBreakIt) {
  Terminal t;
  std::mt19937_64 random(7);
  constexpr std::string_view kWords[] = {"conf ",
                                         "set ",
                                         "get ",
                                         "servo.pid_position.kp ",
                                         "1e400 ",
                                         "nan ",
                                         "-",
                                         "d ",
                                         "pos ",
                                         "tel ",
                                         "rate ",
                                         "fmt ",
                                         "servo_stats ",
                                         "\n",
                                         "exact ",
                                         "9",
                                         "\xff",
                                         "id.id ",
                                         "servo.timeout_mode "};
  for (int round = 0; round < 20'000; ++round) {
    std::string line;
    for (int i = 0; i < 6; ++i) line += kWords[random() % std::size(kWords)];
    Frame frame = Bench::request({}, {}, 0x807f);
    SubframeWriter writer(frame);
    writer.client_data(1, {reinterpret_cast<const std::uint8_t*>(line.data()), std::min<std::size_t>(line.size(), 60)});
    t.send(frame);
    t.wait_ms(1);
    ASSERT_TRUE(std::isfinite(t.drive().servo().plant().position_rad()));
  }
}

}  // namespace
}  // namespace lithe::hal::sim
