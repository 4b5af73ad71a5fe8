// SPDX-License-Identifier: Apache-2.0
// For those who look after moteus drives: who is on a bus, what it is set to. Through any bus, beside no running robot.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/bus/bus.hpp"
#include "spine/hal/device/moteus_codec.hpp"

namespace lithe::hal::moteus {

struct Found {
  std::uint32_t id = 0;
  std::array<std::uint8_t, 16> uuid{};  // all zero: firmware that has none
  bool maskable = false;                // it can be addressed by its UUID when its id is another's as well
};

// What the frames are; pure.
void make_discovery(Frame& frame);                       // to all, all answer
bool take_discovery(const Frame& answer, Found& found);  // false: no answer to it

// Drives answer to the console one at a time, and so does this.
// Contract: not RT, it waits, but comes back whatever the bus says · one thread, which alone uses the bus
class Terminal {
 public:
  struct Time {
    std::function<std::int64_t()> now_ns;  // CLOCK_MONOTONIC
    std::function<void()> pause;           // a moment in which an answer may come
  };
  Terminal(Bus& bus, Time time) : bus_(bus), time_(std::move(time)) {}

  // Everybody who answers within the time, in order of their ids; two with the same id are both there.
  std::vector<Found> discover(std::int64_t wait_ns = 100'000'000);

  // One line to a drive's console ("d stop"); what it said before "OK". The error has the drive's own words, or says
  // that none came.
  Result<std::string> command(std::uint32_t id, std::string_view line);

  // A setting by the name the firmware gives it ("servo.pid_position.kp"). Setting it does not store it: command(id,
  // "conf write") does, when the drive is stopped.
  Result<std::string> setting(std::uint32_t id, std::string_view name);
  Result<> set(std::uint32_t id, std::string_view name, std::string_view value);

 private:
  struct Wait {
    std::int64_t end_ns;
    int frames_after = 256;
  };
  bool next(Wait& wait, Frame& frame);
  Result<std::string> ask(std::uint32_t id, std::string_view line, bool one_line);
  // The bytes that one exchange with the drive's console brought. `piece` empty: a poll.
  Result<std::string> exchange(std::uint32_t id, std::string_view piece);

  Bus& bus_;
  Time time_;
  std::uint32_t source_ = 0;  // our address, another one with each exchange: a late answer is known as such
};

}  // namespace lithe::hal::moteus
