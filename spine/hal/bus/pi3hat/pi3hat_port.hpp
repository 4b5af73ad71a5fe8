// SPDX-License-Identifier: Apache-2.0
// The thin interface between us and a pi3hat: all five buses and the IMU in one call, as the board's SPI wants it.
// Implemented by the maker's library on a Raspberry Pi, and by a simulated board in tests.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "spine/core/pinned.hpp"
#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal {

inline constexpr std::size_t kPi3hatConnectors = 5;  // JC1 to JC5

struct Pi3hatFrame {
  std::uint32_t connector = 0;  // 1 to 5
  bool answered = false;        // of a frame that is sent: one answer to it is waited for
  Frame frame;
};

struct Pi3hatAttitude {
  std::array<double, 4> attitude{};           // w x y z
  std::array<double, 3> rate_dps{};           // degrees per second, as the board has it
  std::array<double, 3> acceleration_mps2{};  // x y z
};

// Input of one cycle.
struct Pi3hatOrder {
  std::span<const Pi3hatFrame> send;
  std::uint32_t listen = 0;          // bits 1 to 5: read frames there also without an expected answer
  std::int64_t longest_wait_ns = 0;  // longest answer time of a device, without the time of its frames
  bool attitude = false;             // read it if there is a new one
};

struct Pi3hatOutcome {
  std::size_t received = 0;
  bool attitude = false;  // there was a new one
  int error = 0;          // the board's error number; 0 = none. Release 1.0.0 reports none: a dead board is silent
};

// Contract: RT as far as the hardware is: busy, bounded, no allocation once its lists have grown · one thread
class Pi3hatPort : public Interface {
 public:
  // Sends all frames, waits for the answers, reads at most received.size() frames, the oldest first. Frames that do not
  // fit stay in the board; without room nothing is read.
  virtual Pi3hatOutcome cycle(const Pi3hatOrder& order, std::span<Pi3hatFrame> received, Pi3hatAttitude& attitude)
      LITHE_RT = 0;
};

struct Pi3hatLine {
  bool used = false;  // if not, it is set to listen only and does not disturb a connected bus
  std::uint32_t bitrate = 1'000'000;
  std::uint32_t data_bitrate = 5'000'000;  // 0 = this connector carries classic CAN
};

struct Pi3hatParams {
  std::array<Pi3hatLine, kPi3hatConnectors> lines;
};

// The board of this machine. The error says what to do; in a build without the maker's library, how to get it.
// Contract: never in the tick · one per machine
Result<std::unique_ptr<Pi3hatPort>> open_pi3hat_port(const Pi3hatParams& params);

}  // namespace lithe::hal
