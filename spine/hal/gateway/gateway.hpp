// SPDX-License-Identifier: Apache-2.0
// A sensor gateway: a microcontroller that sends analog and digital inputs and an IMU on the bus by itself.
//
// Its frames have extended ids, which moteus and CANopen devices do not send:
//   id      0x10400000 | node << 8 | block       node 1 to 126
//   byte 0  sequence: counts all frames of the node, wraps
//   byte 1  first channel
//   2, 3    time of the sample in 100 us, wraps (little-endian, as all below): the age of the values comes from it,
//           also when they were delayed or the sampling has stopped
//   4 ...   analog, imu: one int16 per channel, -32768 = not valid
//           digital: uint16 values, uint16 valid, one bit per channel; first channel 0
// Classic CAN holds two channels per frame, CAN FD all sixteen. A reference sketch is in firmware/.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "spine/core/rt.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/core/sensors.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::gateway {

inline constexpr std::uint32_t kIdBase = 0x10400000;
inline constexpr std::uint32_t kIdMask = 0x1fff8000;
inline constexpr std::size_t kChannels = 16;  // of each block
inline constexpr std::size_t kHeader = 4;     // bytes of a frame before its channels
inline constexpr std::int16_t kInvalid = -32768;

// The unit of a count is the sensor's `scale` in robot.toml.
using hal::Block;
using hal::kBlocks;

constexpr bool is_gateway(const Frame& frame) LITHE_RT { return frame.extended && (frame.id & kIdMask) == kIdBase; }
constexpr std::uint32_t node_of(const Frame& frame) LITHE_RT { return frame.id >> 8 & 0x7f; }

struct Counters {
  std::uint64_t frames = 0;
  std::uint64_t lost = 0;       // from gaps in the sequence; a repeated or late frame is not a gap
  std::uint64_t repeated = 0;   // the same sequence number again, or an older one: not used
  std::uint64_t malformed = 0;  // not used, either
};

// The last values of one gateway.
// Contract: as hal::SensorDevice
class Gateway final : public SensorDevice {
 public:
  // A channel without a new value for `stale_ns` is not valid.
  Gateway(std::uint32_t node, std::int64_t stale_ns) : node_(node), stale_ns_(stale_ns) {}

  std::uint32_t node() const LITHE_RT { return node_; }
  bool sent(const Frame& frame) const LITHE_RT override { return is_gateway(frame) && node_of(frame) == node_; }
  void on_frame(const Frame& frame, std::int64_t now_ns) LITHE_RT override;
  bool read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT override;
  std::uint64_t repeated() const LITHE_RT override { return counters_.repeated; }
  std::uint64_t malformed() const LITHE_RT override { return counters_.malformed; }

  const Counters& counters() const LITHE_RT { return counters_; }

 private:
  struct Channel {
    double raw = 0;
    std::int64_t taken_ns = 0;
    bool valid = false;
  };
  bool follows(std::uint8_t sequence) LITHE_RT;
  std::int64_t sampled_ns(std::uint16_t stamp, std::int64_t now_ns) LITHE_RT;
  void read_words(Block block, const Frame& frame, std::int64_t now_ns) LITHE_RT;
  void read_bits(const Frame& frame, std::int64_t now_ns) LITHE_RT;

  std::uint32_t node_;
  std::int64_t stale_ns_;
  bool heard_ = false;
  std::uint8_t sequence_ = 0;
  std::uint16_t stamp_ = 0;
  std::int64_t last_ns_ = 0;   // when the last frame came
  std::int64_t stamp_ns_ = 0;  // of its stamp, on the gateway's own clock
  std::int64_t ahead_ns_ = 0;  // smallest difference of our clock to the gateway's so far: the least delayed frame
  std::array<std::array<Channel, kChannels>, kBlocks> channels_{};
  Counters counters_;
};

// They are never asked.
std::unique_ptr<Scanner> make_scanner();
FrameText frame_text(const Frame& frame, const FrameContext& context);

// Of a robot file. It sends at the rate of the sketch in firmware/, one block after the other.
std::unique_ptr<SensorDevice> make_gateway(const robot::DeviceConfig& device);
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);

}  // namespace lithe::hal::gateway
