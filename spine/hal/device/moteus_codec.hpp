// SPDX-License-Identifier: Apache-2.0
// The moteus register protocol as bytes: no I/O, no state, no units but the device's own (revolutions).
// Source: the register protocol of mjbots moteus, firmware 1.0, register map 5.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/core/rt.hpp"

namespace lithe::hal::moteus {

enum class Resolution : std::uint8_t { int8 = 0, int16 = 1, int32 = 2, f32 = 3 };

// What a register holds decides how its integers are scaled.
enum class Kind : std::uint8_t {
  position, velocity, acceleration, torque, scale, voltage, temperature, current, time, power, integer
};

enum Register : std::uint32_t {
  kMode = 0x000, kPosition = 0x001, kVelocity = 0x002, kTorque = 0x003, kQCurrent = 0x004, kDCurrent = 0x005,
  kAbsPosition = 0x006, kPower = 0x007, kMotorTemperature = 0x00a, kTrajectoryComplete = 0x00b, kHomeState = 0x00c,
  kVoltage = 0x00d, kTemperature = 0x00e, kFault = 0x00f,
  kCommandPosition = 0x020, kCommandVelocity = 0x021, kFeedforwardTorque = 0x022, kKpScale = 0x023, kKdScale = 0x024,
  kMaxTorque = 0x025, kStopPosition = 0x026, kWatchdogTimeout = 0x027, kVelocityLimit = 0x028, kAccelLimit = 0x029,
  kIlimitScale = 0x02b, kModel = 0x100, kFirmware = 0x101, kRegisterMap = 0x102,
};

enum Mode : std::uint8_t {
  kStopped = 0, kFaulted = 1, kEnabling = 2, kCalibrating = 3, kCalibrationComplete = 4, kPositionMode = 10,
  kTimeout = 11, kZeroVelocity = 12, kStayWithin = 13, kBrakeMode = 15,
};

inline constexpr std::uint8_t kNop = 0x50;
inline constexpr std::size_t kMaxPayload = 64;

Kind kind_of(std::uint32_t address) LITHE_RT;

// Value of the least significant bit of a `kind` at an integer resolution.
double lsb(Kind kind, Resolution resolution) LITHE_RT;

// Scaled integer of `value`: truncated toward zero, saturated; NaN becomes the smallest integer.
std::int32_t to_raw(double value, Kind kind, Resolution resolution) LITHE_RT;
double from_raw(std::int32_t raw, Kind kind, Resolution resolution) LITHE_RT;

// Bytes the frame grows to: FD knows 0-8, 12, 16, 20, 24, 32, 48 and 64.
std::size_t padded_size(std::size_t size) LITHE_RT;

// Writes subframes into a caller's buffer. What does not fit is dropped whole and noted in ok().
// Contract: RT · a value, one thread
class Writer {
 public:
  explicit Writer(std::span<std::uint8_t, kMaxPayload> buffer) : buffer_(buffer) {}

  // Writes `values` to consecutive registers from `start`.
  void write(std::uint32_t start, Resolution resolution, std::span<const double> values) LITHE_RT;
  // Answers a read: the same with the reply code.
  void reply(std::uint32_t start, Resolution resolution, std::span<const double> values) LITHE_RT;
  // Asks for `count` consecutive registers from `start`.
  void read(std::uint32_t start, Resolution resolution, std::uint32_t count) LITHE_RT;
  // Answers what cannot be done: 1 unknown register or bad value, 2 not writable.
  void error(bool writing, std::uint32_t address, std::uint32_t code) LITHE_RT;
  // Pads with NOPs to a length FD knows and returns it.
  std::size_t finish() LITHE_RT;

  std::size_t size() const LITHE_RT { return size_; }
  bool ok() const LITHE_RT { return ok_; }

 private:
  void values(std::uint8_t code, std::uint32_t start, Resolution resolution, std::span<const double> data) LITHE_RT;
  bool room(std::size_t bytes) LITHE_RT;
  void byte(std::uint8_t value) LITHE_RT { buffer_[size_++] = value; }
  void varuint(std::uint32_t value) LITHE_RT;
  void value(double data, std::uint32_t address, Resolution resolution) LITHE_RT;

  std::span<std::uint8_t, kMaxPayload> buffer_;
  std::size_t size_ = 0;
  bool ok_ = true;
};

// One thing a frame says.
struct Subframe {
  enum class Type : std::uint8_t { write, read, reply, write_error, read_error, unknown };
  Type type = Type::unknown;
  Resolution resolution = Resolution::int8;
  std::uint32_t start = 0;               // first register
  std::uint32_t count = 0;               // registers; the error code of an error
  std::array<double, 32> values{};       // of a write or reply, the first `count`
};

// Takes a payload apart, subframe by subframe. Malformed bytes end it; nothing is ever read past the end.
// Contract: RT · a value, one thread
class Reader {
 public:
  explicit Reader(std::span<const std::uint8_t> payload) : payload_(payload) {}

  // The next subframe; false at the end or where the bytes make no sense (then malformed() is set).
  bool next(Subframe& subframe) LITHE_RT;
  bool malformed() const LITHE_RT { return malformed_; }

 private:
  bool varuint(std::uint32_t& value) LITHE_RT;
  bool value(std::uint32_t address, Resolution resolution, double& out) LITHE_RT;
  bool fail() LITHE_RT {
    malformed_ = true;
    at_ = payload_.size();
    return false;
  }

  std::span<const std::uint8_t> payload_;
  std::size_t at_ = 0;
  bool malformed_ = false;
};

// Arbitration id of a frame from `source` to `destination`; bit 15 asks for a reply.
constexpr std::uint32_t arbitration_id(std::uint32_t source, std::uint32_t destination, bool wants_reply) LITHE_RT {
  return (wants_reply ? 0x8000U : 0U) | (source & 0x7fU) << 8 | (destination & 0x7fU);
}

// True for fault codes that only report a limit at work (96-105): the drive goes on in position mode.
constexpr bool is_limit_code(std::uint32_t code) LITHE_RT { return code >= 96 && code <= 105; }

// The fault's name for people, "unknown" for a code this build does not know.
const char* fault_name(std::uint32_t code) LITHE_RT;

}  // namespace lithe::hal::moteus
