// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/device/gateway.hpp"

namespace lithe::hal::gateway {
namespace {

constexpr std::size_t kHeader = 4;

std::uint16_t word_at(const Frame& frame, std::size_t at) LITHE_RT {
  return static_cast<std::uint16_t>(frame.data[at] | frame.data[at + 1] << 8);
}

}  // namespace

// A sequence number that is up to half a turn behind is an old frame, not a gap of more than half a turn. After a
// restart of the gateway that can hold up its first frames: never more than 128.
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

void Gateway::take(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  const std::size_t size = frame.payload().size();
  const std::uint32_t block = frame.id & 0xff;
  const bool whole = block < kBlocks && size >= kHeader + 2 && (size - kHeader) % 2 == 0 && frame.data[1] < kChannels;
  const bool digital = block == static_cast<std::uint32_t>(Block::digital);
  if (!whole || (digital && (size < kHeader + 4 || frame.data[1] != 0))) {
    ++counters_.malformed;
    return;
  }
  if (!follows(frame.data[0])) return;
  ++counters_.frames;
  if (digital) {
    take_bits(frame, now_ns);
  } else {
    take_words(static_cast<Block>(block), frame, now_ns);
  }
}

// What lies behind the last channel is padding: CAN FD knows only some lengths.
void Gateway::take_words(Block block, const Frame& frame, std::int64_t now_ns) LITHE_RT {
  auto& channels = channels_[static_cast<std::size_t>(block)];
  const std::size_t words = (frame.payload().size() - kHeader) / 2;
  for (std::size_t i = 0; i < words && frame.data[1] + i < kChannels; ++i) {
    const auto raw = static_cast<std::int16_t>(word_at(frame, kHeader + 2 * i));
    channels[frame.data[1] + i] = {static_cast<double>(raw), now_ns, raw != kInvalid};
  }
}

void Gateway::take_bits(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  auto& channels = channels_[static_cast<std::size_t>(Block::digital)];
  const std::uint32_t values = word_at(frame, kHeader), valid = word_at(frame, kHeader + 2);
  for (std::size_t i = 0; i < kChannels; ++i) {
    channels[i] = {static_cast<double>(values >> i & 1), now_ns, (valid >> i & 1) != 0};
  }
}

bool Gateway::read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT {
  if (channel >= kChannels) return false;
  const Channel& found = channels_[static_cast<std::size_t>(block)][channel];
  if (!found.valid || now_ns - found.taken_ns > stale_ns_) return false;
  raw = found.raw;
  return true;
}

}  // namespace lithe::hal::gateway
