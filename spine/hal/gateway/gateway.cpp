// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/gateway/gateway.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::hal::gateway {
namespace {

constexpr std::int64_t kStampNs = 100'000;
constexpr std::int64_t kLongestSilenceNs = 3'000'000'000;  // half the range of a time stamp
constexpr std::int64_t kDriftShare = 2000;                 // maximum clock drift assumed: 1 / 2000

std::uint16_t word_at(const Frame& frame, std::size_t at) LITHE_RT {
  return static_cast<std::uint16_t>(little_endian(frame.data.data() + at, 2));
}

}  // namespace

// A sequence number up to half a cycle behind is an old frame, not a gap of more than half a cycle. After a restart of
// the gateway, up to 128 of its first frames may be dropped for this reason. After a long silence any number is
// accepted.
bool Gateway::follows(std::uint8_t sequence) LITHE_RT {
  const auto ahead = static_cast<std::uint8_t>(sequence - sequence_);
  if (heard_ && (ahead == 0 || ahead > 128)) {
    ++counters_.repeated;
    return false;
  }
  if (heard_) counters_.lost += ahead - 1U;
  heard_ = true;
  sequence_ = sequence;
  return true;
}

void Gateway::on_frame(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  const std::size_t size = frame.payload().size();
  const std::uint32_t block = frame.id & 0xff;
  const bool whole = block < kBlocks && size >= kHeader + 2 && (size - kHeader) % 2 == 0 && frame.data[1] < kChannels;
  const bool digital = block == static_cast<std::uint32_t>(Block::digital);
  if (!whole || (digital && (size < kHeader + 4 || frame.data[1] != 0))) {
    ++counters_.malformed;
    return;
  }
  if (now_ns - last_ns_ > std::min(stale_ns_, kLongestSilenceNs)) heard_ = false;
  const bool first = !heard_;
  if (!follows(frame.data[0])) return;
  ++counters_.frames;
  const std::uint16_t stamp = word_at(frame, 2);
  if (first) {
    stamp_ = stamp;
    stamp_ns_ = 0;
    ahead_ns_ = last_ns_ = now_ns;
  }
  const std::int64_t taken_ns = sampled_ns(stamp, now_ns);
  if (digital)
    read_bits(frame, taken_ns);
  else
    read_words(static_cast<Block>(block), frame, taken_ns);
}

// Sampling time on our clock: the clock offset is the smallest delay of any frame so far; the clocks drift slowly.
std::int64_t Gateway::sampled_ns(std::uint16_t stamp, std::int64_t now_ns) LITHE_RT {
  stamp_ns_ += kStampNs * static_cast<std::uint16_t>(stamp - stamp_);
  ahead_ns_ += (now_ns - last_ns_) / kDriftShare;
  ahead_ns_ = std::min(ahead_ns_, now_ns - stamp_ns_);
  stamp_ = stamp;
  last_ns_ = now_ns;
  return stamp_ns_ + ahead_ns_;
}

// Bytes after the last channel are padding: CAN FD has only certain lengths.
void Gateway::read_words(Block block, const Frame& frame, std::int64_t now_ns) LITHE_RT {
  auto& channels = channels_[static_cast<std::size_t>(block)];
  const std::size_t words = (frame.payload().size() - kHeader) / 2;
  for (std::size_t i = 0; i < words && frame.data[1] + i < kChannels; ++i) {
    const auto raw = static_cast<std::int16_t>(word_at(frame, kHeader + 2 * i));
    channels[frame.data[1] + i] = {static_cast<double>(raw), now_ns, raw != kInvalid};
  }
}

void Gateway::read_bits(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  auto& channels = channels_[static_cast<std::size_t>(Block::digital)];
  const std::uint32_t values = word_at(frame, kHeader), valid = word_at(frame, kHeader + 2);
  for (std::size_t i = 0; i < kChannels; ++i)
    channels[i] = {static_cast<double>(values >> i & 1), now_ns, (valid >> i & 1) != 0};
}

bool Gateway::read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT {
  if (channel >= kChannels) return false;
  const Channel& found = channels_[static_cast<std::size_t>(block)][channel];
  if (!found.valid || now_ns - found.taken_ns > stale_ns_) return false;
  raw = found.raw;
  return true;
}

std::unique_ptr<SensorDevice> make_gateway(const robot::DeviceConfig& device) {
  return std::make_unique<Gateway>(device.id, std::llround(1e9 * device.watchdog_s));
}

PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus) {
  constexpr double kFramesPerS = 2000;
  const bool fd = is_fd(bus);
  const auto block = [&](const char* what, std::size_t size, double per_s) {
    return PlannedFrame{
        .what = what, .size = size, .id = kIdBase | device.id << 8, .fd = fd, .per_s = per_s, .unasked = true};
  };
  if (!fd) return {block("inputs", 8, kFramesPerS)};
  return {block("analog", fd_size(4 + 2 * kChannels), kFramesPerS / 2), block("digital", 8, kFramesPerS / 2)};
}

}  // namespace lithe::hal::gateway
