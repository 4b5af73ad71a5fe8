// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/gateway/sim/sim_gateway.hpp"

#include <cmath>
#include <numbers>

namespace lithe::hal::sim {
namespace {

using gateway::Block;
using gateway::kHeader;

constexpr std::size_t kImuChannels = 10;
constexpr double kAmplitude = 1000;
constexpr std::int16_t kOne = 30000;  // of the quaternion
constexpr std::int16_t kGravity = 981;
constexpr std::uint32_t kClassicTurns = gateway::kChannels / 2 + 1 + kImuChannels / 2;
constexpr std::uint32_t kFdTurns = gateway::kBlocks;

// The block of this turn, and its first channel.
struct Turn {
  Block block;
  std::uint8_t first;
  std::size_t channels;
};

Turn turn_of(std::uint32_t turn, bool fd) LITHE_RT {
  if (fd) {
    constexpr std::array<Turn, kFdTurns> kBlocks{{{Block::analog, 0, gateway::kChannels},
                                                  {Block::digital, 0, gateway::kChannels},
                                                  {Block::imu, 0, kImuChannels}}};
    return kBlocks[turn % kFdTurns];
  }
  turn %= kClassicTurns;
  if (turn < gateway::kChannels / 2) return {Block::analog, static_cast<std::uint8_t>(2 * turn), 2};
  turn -= static_cast<std::uint32_t>(gateway::kChannels / 2);
  if (turn == 0) return {Block::digital, 0, gateway::kChannels};
  return {Block::imu, static_cast<std::uint8_t>(2 * (turn - 1)), 2};
}

}  // namespace

void SimGateway::on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  if (start_ns_ == 0) start_ns_ = next_ns_ = now_ns;
  // At most one frame: missed ones are not sent later.
  if (now_ns < next_ns_) return;
  next_ns_ = now_ns - next_ns_ < period_ns_ ? next_ns_ + period_ns_ : now_ns + period_ns_;
  send(now_ns, answers);
}

bool SimGateway::inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT {
  constexpr std::int64_t kBootNs = 100'000'000;
  if (injected == InjectedFault::other_map) {
    other_map_ = begins;
    return true;
  }
  if (injected != InjectedFault::power_loss) return false;
  if (begins) {
    next_ns_ = now_ns + kBootNs;
    sequence_ = 0;
    turn_ = 0;
  }
  return true;
}

std::int16_t SimGateway::word(Block block, std::size_t channel, double time_s) const LITHE_RT {
  if ((unplugged_[static_cast<std::size_t>(block)] >> channel & 1) != 0) return gateway::kInvalid;
  if (block == Block::analog) {
    const double swing = std::sin(2 * std::numbers::pi * time_s + static_cast<double>(channel));
    return static_cast<std::int16_t>(std::lround(kAmplitude * swing));
  }
  return channel == 0 ? kOne : channel == 9 ? kGravity : std::int16_t{0};
}

void SimGateway::send(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  const Turn turn = turn_of(turn_++, fd_);
  const std::int64_t since_ns = now_ns - start_ns_;
  const double time_s = 1e-9 * static_cast<double>(since_ns);
  Frame frame;
  frame.id = gateway::kIdBase | node_ << 8 | static_cast<std::uint32_t>(turn.block);
  frame.extended = true;
  frame.fd = frame.brs = fd_;
  frame.data[0] = ++sequence_;
  frame.data[1] = other_map_ ? gateway::kChannels : turn.first;  // which is beyond the last one
  put_little_endian(frame.data.data() + 2, static_cast<std::uint32_t>(since_ns / 100'000), 2);
  std::size_t size = kHeader + 2 * turn.channels;
  if (turn.block == Block::digital) {
    std::uint32_t values = 0;
    for (std::uint32_t c = 0; c < turn.channels; ++c) {
      const auto half_periods = static_cast<std::uint32_t>(time_s / 30 * static_cast<double>(1U << c));
      values |= (half_periods & 1) << c;
    }
    put_little_endian(frame.data.data() + kHeader, values, 2);
    put_little_endian(frame.data.data() + kHeader + 2, ~unplugged_[static_cast<std::size_t>(turn.block)], 2);
    size = kHeader + 4;
  } else {
    for (std::size_t i = 0; i < turn.channels; ++i)
      put_little_endian(frame.data.data() + kHeader + 2 * i,
                        static_cast<std::uint16_t>(word(turn.block, turn.first + i, time_s)), 2);
  }
  frame.size = static_cast<std::uint8_t>(fd_size(size));
  // Bytes after the last channel of an FD frame are padding.
  for (std::size_t at = size; at + 1 < frame.size; at += 2)
    put_little_endian(frame.data.data() + at, static_cast<std::uint16_t>(gateway::kInvalid), 2);
  answers.push(frame);
}

}  // namespace lithe::hal::sim
