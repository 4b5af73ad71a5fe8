// SPDX-License-Identifier: Apache-2.0
// For those who look after moteus drives: who is on a bus, what it is set to. Through any bus, beside no running robot.
#pragma once

#include <array>
#include <compare>
#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {

struct Found {
  std::uint32_t id = 0;
  std::array<std::uint8_t, 16> uuid{};  // all zero: firmware that has none
  bool maskable = false;                // it can be addressed by its UUID when its id is another's as well

  auto operator<=>(const Found&) const = default;  // by id first
};

// The register map that this house speaks (register 102h); one of another number may mean something else.
inline constexpr std::uint32_t kKnownRegisterMap = 5;

// What a drive says of itself; asking changes nothing.
struct Identity {
  std::uint32_t model = 0;
  std::uint32_t firmware = 0;  // 0x010203 = 1.2.3
  std::uint32_t register_map = 0;
  std::array<std::uint32_t, 3> serial{};
  std::uint32_t mode = 0;
  std::uint32_t fault = 0;
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

  // What it is. Of two with one id only this one is asked, where its firmware can be (Found::maskable).
  Result<Identity> identify(const Found& who);

  // One line to a drive's console ("d stop"); what it said before "OK". The error has the drive's own words, or says
  // that none came.
  Result<std::string> command(std::uint32_t id, std::string_view line);

  // A setting by the name the firmware gives it ("servo.pid_position.kp"). Setting it does not store it: command(id,
  // "conf write") does, when the drive is stopped.
  Result<std::string> setting(std::uint32_t id, std::string_view name);
  Result<> set(std::uint32_t id, std::string_view name, std::string_view value);

 private:
  Result<std::string> ask(std::uint32_t id, std::string_view line, bool one_line);
  // Sends it and waits for a frame of that drive which `is_it`.
  Result<> await(std::uint32_t id, const Frame& question, const std::function<bool(const Frame&)>& is_it);
  // The bytes that one exchange with the drive's console brought. `piece` empty: a poll.
  Result<std::string> exchange(std::uint32_t id, std::string_view piece);

  Bus& bus_;
  Time time_;
  std::uint32_t source_ = 0;  // our address, another one with each question: a late answer is known as such
};

}  // namespace lithe::hal::moteus
