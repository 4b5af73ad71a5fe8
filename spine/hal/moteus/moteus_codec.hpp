// SPDX-License-Identifier: Apache-2.0
// The register protocol of mjbots moteus drives: subframes of register reads, writes and replies in a CAN-FD payload.
// Pure: bytes in, values out; no I/O, no state, no joint.
//
//   byte         meaning                                    followed by
//   00 04 08 0c  write int8, int16, int32, float; + n (1-3) [varuint count if n is 0] varuint register, count values
//   10 14 18 1c  read, same coding                          [varuint count if n is 0] varuint register
//   20 24 28 2c  reply, same coding                         as write
//   30 31        write error, read error                    varuint register, varuint error
//   40 41        data of a stream, to and from the drive    varuint channel, varuint length, bytes
//   42           poll a stream                              varuint channel, varuint longest answer
//   43 44        the same with flow control                 seen, and not understood
//   50           nothing (padding)
// Little-endian; a varuint has 7 bits a byte, lowest first, the top bit says that more follow, 5 bytes at most.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/moteus/keys/moteus_keys.hpp"

namespace lithe::hal::moteus {

// Parts of a CAN id: a reply is asked for; the address of all drives.
inline constexpr std::uint32_t kReplyRequested = 0x8000;
inline constexpr std::uint32_t kBroadcast = 0x7f;

// Register numbers used by LITHE.
namespace reg {
inline constexpr std::uint32_t kMode = 0x000;
inline constexpr std::uint32_t kPosition = 0x001;
inline constexpr std::uint32_t kVelocity = 0x002;
inline constexpr std::uint32_t kTorque = 0x003;
inline constexpr std::uint32_t kQCurrent = 0x004;
inline constexpr std::uint32_t kDCurrent = 0x005;
inline constexpr std::uint32_t kAbsPosition = 0x006;
inline constexpr std::uint32_t kPower = 0x007;
inline constexpr std::uint32_t kMotorTemperature = 0x00a;
inline constexpr std::uint32_t kTrajectoryComplete = 0x00b;
inline constexpr std::uint32_t kHomeState = 0x00c;
inline constexpr std::uint32_t kVoltage = 0x00d;
inline constexpr std::uint32_t kTemperature = 0x00e;
inline constexpr std::uint32_t kFault = 0x00f;
inline constexpr std::uint32_t kCommandQCurrent = 0x01c;
inline constexpr std::uint32_t kCommandDCurrent = 0x01d;
inline constexpr std::uint32_t kCommandPosition = 0x020;
inline constexpr std::uint32_t kCommandVelocity = 0x021;
inline constexpr std::uint32_t kCommandTorque = 0x022;
inline constexpr std::uint32_t kKpScale = 0x023;
inline constexpr std::uint32_t kKdScale = 0x024;
inline constexpr std::uint32_t kMaxTorque = 0x025;
inline constexpr std::uint32_t kStopPosition = 0x026;
inline constexpr std::uint32_t kWatchdog = 0x027;
inline constexpr std::uint32_t kVelocityLimit = 0x028;
inline constexpr std::uint32_t kAccelerationLimit = 0x029;
inline constexpr std::uint32_t kIntegralScale = 0x02b;
inline constexpr std::uint32_t kIgnoreBounds = 0x02d;
inline constexpr std::uint32_t kTermP = 0x030;  // to 034: I, D, feed-forward, what comes of them
inline constexpr std::uint32_t kControlPosition = 0x038;
inline constexpr std::uint32_t kControlVelocity = 0x039;
inline constexpr std::uint32_t kErrorPosition = 0x03b;
inline constexpr std::uint32_t kLowerBound = 0x040;  // 042-048 repeat 022 023 024 025 027 02b 02d
inline constexpr std::uint32_t kUpperBound = 0x041;
inline constexpr std::uint32_t kEncoder = 0x050;  // position and velocity of three encoders
inline constexpr std::uint32_t kEncoderValidity = 0x058;
inline constexpr std::uint32_t kAuxGpioCommand = 0x05c;  // two ports
inline constexpr std::uint32_t kAuxGpioStatus = 0x05e;   // two ports
inline constexpr std::uint32_t kAux1Analog = 0x060;      // five pins
inline constexpr std::uint32_t kAux2Analog = 0x068;      // five pins
inline constexpr std::uint32_t kMillisecondCounter = 0x070;
inline constexpr std::uint32_t kClockTrim = 0x071;
inline constexpr std::uint32_t kPwmInput = 0x072;  // period and duty cycle of two ports
inline constexpr std::uint32_t kAuxPwm = 0x076;    // five pins of each of two ports
inline constexpr std::uint32_t kModel = 0x100;
inline constexpr std::uint32_t kFirmware = 0x101;
inline constexpr std::uint32_t kRegisterMap = 0x102;
inline constexpr std::uint32_t kId = 0x110;
inline constexpr std::uint32_t kSerial = 0x120;  // and 121, 122
inline constexpr std::uint32_t kSetOutputNearest = 0x130;
inline constexpr std::uint32_t kSetOutputExact = 0x131;
inline constexpr std::uint32_t kRequireReindex = 0x132;
inline constexpr std::uint32_t kRecapture = 0x133;
inline constexpr std::uint32_t kDriverFault = 0x140;  // and 141
inline constexpr std::uint32_t kUuid = 0x150;         // four words
inline constexpr std::uint32_t kUuidMask = 0x154;     // four words: drives with another UUID ignore the frame
inline constexpr std::uint32_t kUuidMaskCapable = 0x158;
}  // namespace reg

enum class Mode : std::uint8_t {
  stopped = 0,
  fault = 1,
  enabling = 2,
  calibrating = 3,
  calibration_complete = 4,
  pwm = 5,
  voltage = 6,
  voltage_foc = 7,
  voltage_dq = 8,
  current = 9,
  position = 10,
  timeout = 11,  // watchdog timeout; latched until stopped
  zero_velocity = 12,
  stay_within = 13,
  measure_inductance = 14,
  brake = 15,
};

// Codes of the fault register that are used by name; moteus_codec.cpp has the texts of all.
namespace fault {
inline constexpr std::uint32_t kCalibration = 32;
inline constexpr std::uint32_t kDriver = 33;
inline constexpr std::uint32_t kEncoder = 35;
inline constexpr std::uint32_t kOverTemperature = 38;
inline constexpr std::uint32_t kOutsideLimit = 39;
inline constexpr std::uint32_t kStopPosition = 45;
inline constexpr std::uint32_t kLimitVelocity = 96;
inline constexpr std::uint32_t kLimitTemperature = 100;
inline constexpr std::uint32_t kLimitTorque = 102;
inline constexpr std::uint32_t kLimitBounds = 103;
inline constexpr std::uint32_t kLimitFieldWeakening = 105;
}  // namespace fault

// True for the code of an active limit: not a fault, the drive continues.
constexpr bool is_limit(std::uint32_t code) LITHE_RT {
  return code >= fault::kLimitVelocity && code <= fault::kLimitFieldWeakening;
}

// A short text without the code; "none" for 0, "unknown" for other codes. Never null.
// Contract: RT · any thread
const char* fault_name(std::uint32_t code) LITHE_RT;
const char* mode_name(Mode mode) LITHE_RT;

Quantity quantity_of(std::uint32_t number) LITHE_RT;

constexpr std::size_t bytes_of(Format format) LITHE_RT {
  return format == Format::int8 ? 1 : format == Format::int16 ? 2 : 4;
}

// Integers: towards zero, saturated; what is not finite as the smallest integer, which reads as NaN. Writes
// bytes_of(format) bytes.
void encode_value(double value, Quantity quantity, Format format, std::uint8_t* out) LITHE_RT;
double decode_value(const std::uint8_t* in, Quantity quantity, Format format) LITHE_RT;

enum class Kind : std::uint8_t { write, read, reply, write_error, read_error, client_data, server_data, poll, flow };

// Appends subframes to a payload. A subframe that does not fit is left out completely and makes ok() false.
// Contract: RT · pure
class SubframeWriter {
 public:
  explicit SubframeWriter(Frame& frame) LITHE_RT : frame_(&frame) { frame.size = 0; }

  void write(Format format, std::uint32_t start, std::span<const double> values) LITHE_RT;
  void read(Format format, std::uint32_t start, std::uint32_t count) LITHE_RT;
  // Registers from `start` on, each in a format of its own or none: one subframe for each run of the same format. Lists
  // of the same length; `values` without a format are ignored.
  using Choice = std::optional<Format>;
  void write_each(std::uint32_t start, std::span<const Choice> formats, std::span<const double> values) LITHE_RT;
  void read_each(std::uint32_t start, std::span<const Choice> formats) LITHE_RT;
  void client_data(std::uint32_t channel, std::span<const std::uint8_t> bytes) LITHE_RT;
  void poll(std::uint32_t channel, std::uint32_t most) LITHE_RT;

  // For the drive's side. `long_form`: write the count in its own byte, also when three bits would be enough.
  void reply(Format format, std::uint32_t start, std::span<const double> values, bool long_form) LITHE_RT;
  void error(Kind kind, std::uint32_t number, std::uint32_t error) LITHE_RT;
  void server_data(std::uint32_t channel, std::span<const std::uint8_t> bytes) LITHE_RT;
  std::size_t room() const LITHE_RT { return kMaxPayload - frame_->size; }

  // Pads to a valid CAN FD length.
  void pad() LITHE_RT;

  bool ok() const LITHE_RT { return ok_; }

 private:
  void values(std::uint8_t base, Format format, std::uint32_t start, std::span<const double> values, bool long_form)
      LITHE_RT;
  void numbers(std::uint8_t head, std::uint32_t first, std::uint32_t second) LITHE_RT;
  void stream(std::uint8_t head, std::uint32_t channel, std::span<const std::uint8_t> bytes) LITHE_RT;
  bool fits(std::size_t bytes) LITHE_RT;
  void byte(std::uint8_t value) LITHE_RT { frame_->data[frame_->size++] = value; }
  void varuint(std::uint32_t value) LITHE_RT;

  Frame* frame_;
  bool ok_ = true;
};

struct Subframe {
  Kind kind = Kind::read;
  Format format = Format::int8;
  bool long_form = false;
  std::uint32_t start = 0;  // register; channel of a stream
  std::uint32_t count = 0;  // values, or bytes of a stream; a read may ask for more than fits a frame
  std::uint32_t error = 0;
  const std::uint8_t* data = nullptr;

  // Of a write or reply, index < count.
  double value(std::uint32_t index) const LITHE_RT {
    return decode_value(data + index * bytes_of(format), quantity_of(start + index), format);
  }
};

// Iterates over the subframes of any bytes; results are always inside them.
// Contract: RT · pure · at most one subframe per byte
class SubframeReader {
 public:
  explicit SubframeReader(std::span<const std::uint8_t> payload) LITHE_RT : rest_(payload) {}

  // False at the end, or at an invalid byte; then well_formed() is false.
  bool next(Subframe& out) LITHE_RT;
  bool well_formed() const LITHE_RT { return well_formed_; }

 private:
  bool parse(std::uint8_t head, Subframe& out) LITHE_RT;
  bool registers(std::uint8_t head, Subframe& out) LITHE_RT;
  bool varuint(std::uint32_t& value) LITHE_RT;
  bool take(std::size_t bytes, Subframe& out) LITHE_RT;

  std::span<const std::uint8_t> rest_;
  bool well_formed_ = true;
};

}  // namespace lithe::hal::moteus
