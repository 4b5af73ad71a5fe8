// SPDX-License-Identifier: Apache-2.0
// For tests: a simulated CiA 402 drive and a master that sends single frames.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "spine/core/test/units_rig.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/cia402/sim/sim_cia402.hpp"

namespace lithe::hal::sim {
using canopen::NmtCommand;
using canopen::NmtState;
using cia402::State;
namespace abort_code = canopen::abort_code;

inline constexpr double kStands = 0.2;  // [rad/s] a frictionless joint on a coarse encoder is never quite still

// Node 5, without a gear, one rated Nm, at rest; booted.
class Drive402 : public testing::Test {
 protected:
  Drive402() : drive_(params()) {
    drive_.on_time(now_ns_, queue_);
    wait(10);
  }

  static SimCia402Params params() {
    SimCia402Params params;
    params.id = 5;
    params.servo.counts_per_rev = 10'000;
    params.plant.inertia_kg_m2 = 1e-3;
    params.plant.viscous_nm_s_rad = 1e-4;
    return params;
  }

  // All frames that it sends by itself.
  std::vector<Frame> wait(int ms) {
    for (int i = 0; i < ms; ++i) {
      now_ns_ += kMs;
      drive_.on_time(now_ns_, queue_);
    }
    return said();
  }
  std::vector<Frame> said() {
    std::vector<Frame> frames;
    for (; const Frame* frame = queue_.front(); queue_.pop()) frames.push_back(*frame);
    return frames;
  }
  std::vector<Frame> send(const Frame& frame) {
    drive_.on_frame(frame, now_ns_, queue_);
    return said();
  }
  void nmt(NmtCommand command) { send(canopen::nmt_frame(command, 5)); }

  // The abort code, or 0.
  std::uint32_t write(std::uint16_t index, std::uint8_t subindex, std::uint32_t value, std::size_t bytes) {
    return outcome(send(canopen::sdo_write_request(5, {index, subindex}, value, bytes)));
  }
  std::uint32_t why_unread(std::uint16_t index, std::uint8_t subindex) {
    return outcome(send(canopen::sdo_read_request(5, {index, subindex})));
  }
  std::uint32_t read(std::uint16_t index, std::uint8_t subindex = 0) {
    const std::vector<Frame> frames = send(canopen::sdo_read_request(5, {index, subindex}));
    EXPECT_EQ(outcome(frames), 0U) << std::hex << index;
    const Frame& frame = frames.front();
    return little_endian(frame.data.data() + 4, canopen::sdo_expedited_bytes(frame.data[0]));
  }
  static std::uint32_t outcome(const std::vector<Frame>& frames) {
    const auto answer =
        std::find_if(frames.begin(), frames.end(), [](const Frame& frame) { return frame.id == 0x585; });
    if (answer == frames.end()) return 0xffff'ffff;
    return answer->data[0] == 0x80 ? little_endian(answer->data.data() + 4, 4) : 0;
  }
  std::string read_text(std::uint16_t index) {
    const std::vector<Frame> start = send(canopen::sdo_read_request(5, {index, 0}));
    std::string text;
    bool toggle = false;
    for (bool last = false; !last && text.size() < 100; toggle = !toggle) {
      const Frame segment = send(canopen::sdo_segment_request(5, toggle)).at(0);
      const std::size_t bytes = 7 - (segment.data[0] >> 1 & 7U);
      text.append(segment.data.begin() + 1, segment.data.begin() + 1 + static_cast<std::ptrdiff_t>(bytes));
      last = (segment.data[0] & 1) != 0;
    }
    EXPECT_EQ(little_endian(start.at(0).data.data() + 4, 4), text.size());
    return text;
  }
  void control(std::uint16_t word) { EXPECT_EQ(write(0x6040, 0, word, 2), 0U); }
  State state() {
    State state{};
    EXPECT_TRUE(cia402::decode_state(static_cast<std::uint16_t>(read(0x6041)), state));
    return state;
  }
  void enable(std::uint8_t mode) {
    write(0x6060, 0, mode, 1);
    for (const std::uint16_t word : std::array<std::uint16_t, 3>{0x06, 0x07, 0x0f}) control(word);
    ASSERT_EQ(state(), State::operation_enabled);
  }
  double velocity() { return drive_.servo().plant().velocity_rad_s(); }

  FrameQueue queue_;
  std::int64_t now_ns_ = 1'000 * kMs;
  SimCia402 drive_;
};

}  // namespace lithe::hal::sim
