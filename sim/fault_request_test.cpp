// SPDX-License-Identifier: Apache-2.0
#include "sim/fault_request.hpp"

#include <gtest/gtest.h>

#include <random>

namespace lithe::simulator {
namespace {

TEST(FaultRequest, SaysWhatShallHappenToWhat) {
  const auto drop = parse_order(R"({"fault": "drop", "bus": "can0", "share": 0.25, "for_s": 2, "after_s": 1})");
  ASSERT_TRUE(drop) << drop.message();
  EXPECT_EQ(drop->kind, FaultRequest::Kind::drop);
  EXPECT_EQ(drop->bus, "can0");
  EXPECT_EQ(drop->amount, 0.25);
  EXPECT_EQ(drop->for_s, 2);
  EXPECT_EQ(drop->after_s, 1);
  EXPECT_EQ(undone(*drop).amount, 0);
  EXPECT_EQ(undone(*drop).for_s, 0);
  EXPECT_DOUBLE_EQ(parse_order(R"({"fault": "delay", "ms": 5})")->amount, 0.005);
  EXPECT_FALSE(parse_order(R"({"fault": "encoder", "device": "elbow", "on": false})")->on);
  EXPECT_TRUE(parse_order(R"({"fault": "reset"})")->on);
}

TEST(FaultRequest, RefusesWithWhatWouldBeRight) {
  const std::pair<const char*, const char*> cases[] = {
      {"", "not a JSON object"},
      {"[]", "not a JSON object"},
      {"{\"fault\": ", "not a JSON object"},
      {"{}", "must be one of drop, corrupt"},
      {R"({"fault": 3})", "must be one of"},
      {R"({"fault": "jump"})", "must be one of"},
      {R"({"fault": "drop"})", "say how many"},
      {R"({"fault": "drop", "share": 2})", "from 0 to 1"},
      {R"({"fault": "drop", "share": "all"})", "must be a number"},
      {R"({"fault": "delay"})", "say how long"},
      {R"({"fault": "delay", "ms": -1})", "must be a number"},
      {R"({"fault": "reset", "device": 3})", "must be a name"},
      {R"({"fault": "encoder", "on": 1})", "true or false"},
      {R"({"fault": "reset", "devise": "a"})", "there is no \"devise\""},
      {R"({"fault": "twin", "bus": "can0"})", "say \"device\""},
      {R"({"fault": "drop", "device": "m1", "share": 1})", "say \"bus\""},
      {R"({"fault": "delay", "ms": 5, "on": false})", "\"ms\": 0 ends it"},
      {R"({"fault": "reset", "share": 1})", "some frames"},
      {R"({"fault": "clear", "bus": "can0"})", "faults of a bus"},
  };
  for (const auto& [line, words] : cases) {
    const auto order = parse_order(line);
    ASSERT_FALSE(order) << line;
    EXPECT_NE(order.message().find(words), std::string::npos) << line << ": " << order.message();
  }
}

TEST(FaultRequest, AnyBytesAreRefusedOrUnderstood) {
  std::mt19937_64 random(8);
  const std::string good = R"({"fault": "drop", "bus": "can0", "share": 0.25})";
  for (int round = 0; round < 20'000; ++round) {
    std::string line = good;
    for (int i = 0; i < 3; ++i) line[random() % line.size()] = static_cast<char>(random());
    const auto order = parse_order(line);
    EXPECT_TRUE(!order || order->amount <= 1) << line;
  }
}

}  // namespace
}  // namespace lithe::simulator
