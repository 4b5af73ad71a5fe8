// SPDX-License-Identifier: Apache-2.0
// Maintenance of moteus drives: discovery and settings, through any bus. Not while a robot runs on it.
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
  bool maskable = false;                // can be addressed by its UUID when another drive has the same id

  auto operator<=>(const Found&) const = default;  // by id first
};

// The register map that LITHE uses (register 102h); another number may mean other registers.
inline constexpr std::uint32_t kKnownRegisterMap = 5;

// Identity of a drive; read-only.
struct Identity {
  std::uint32_t model = 0;
  std::uint32_t firmware = 0;  // 0x010203 = 1.2.3
  std::uint32_t register_map = 0;
  std::array<std::uint32_t, 3> serial{};
  std::uint32_t mode = 0;
  std::uint32_t fault = 0;
};

// The frames; pure.
void make_discovery(Frame& frame);                       // to all, all answer
bool take_discovery(const Frame& answer, Found& found);  // false: not an answer to it

// A console conversation with one drive at a time.
// Contract: not RT: waits, but always returns within a time limit · one thread, which alone uses the bus
class Terminal {
 public:
  struct Time {
    std::function<std::int64_t()> now_ns;  // CLOCK_MONOTONIC
    std::function<void()> pause;           // waits briefly for an answer
  };
  Terminal(Bus& bus, Time time) : bus_(bus), time_(std::move(time)) {}

  // All drives that answer in time, in order of their ids; two with the same id are both listed.
  std::vector<Found> discover(std::int64_t wait_ns = 100'000'000);

  // Reads its identity. Of two drives with one id only this one is asked, if its firmware supports it
  // (Found::maskable).
  Result<Identity> identify(const Found& who);

  // Sends one line to a drive's console ("d stop") and returns its output before "OK". The error has the drive's text,
  // or says that there was no answer.
  Result<std::string> command(std::uint32_t id, std::string_view line);

  // A setting by the name the firmware gives it ("servo.pid_position.kp"). Setting it does not store it: command(id,
  // "conf write") does, when the drive is stopped.
  Result<std::string> setting(std::uint32_t id, std::string_view name);
  Result<> set(std::uint32_t id, std::string_view name, std::string_view value);

 private:
  Result<std::string> ask(std::uint32_t id, std::string_view line, bool one_line);
  // Sends it and waits for a frame of that drive for which `is_it` is true.
  Result<> await(std::uint32_t id, const Frame& question, const std::function<bool(const Frame&)>& is_it);
  // The bytes received in one exchange with the drive's console. `piece` empty: a poll.
  Result<std::string> exchange(std::uint32_t id, std::string_view piece);

  Bus& bus_;
  Time time_;
  std::uint32_t source_ = 0;  // our address; changes with each question, to recognise late answers
};

}  // namespace lithe::hal::moteus
