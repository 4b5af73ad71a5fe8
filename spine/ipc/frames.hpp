// SPDX-License-Identifier: Apache-2.0
// Segment with the frames of a running robot's buses, for bus monitors. Not in the schema, because nothing depends on
// it. The Spine writes it, except one word.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/ipc/layout.hpp"

namespace lithe::ipc {

namespace frame_flag {
inline constexpr std::uint8_t kOutbound = 1;  // from the Spine
inline constexpr std::uint8_t kExtended = 2;
inline constexpr std::uint8_t kFd = 4;
inline constexpr std::uint8_t kBrs = 8;
}  // namespace frame_flag

struct FrameRecord {
  std::int64_t time_ns = 0;  // CLOCK_MONOTONIC when the Transport sent it, or found it
  std::uint32_t id = 0;
  std::uint8_t bus = 0;  // number in the robot file, from 0
  std::uint8_t size = 0;
  std::uint8_t flags = 0;
  std::uint8_t reserved = 0;
  std::array<std::uint8_t, 64> data{};
};
static_assert(Payload<FrameRecord>);

// Of one bus since it was opened; each word is exact, together they may be of two exchanges.
struct alignas(kLine) BusCounts {
  std::array<char, 32> name;
  std::uint64_t sent, received, refused, late, malformed, errors, reopened;
};

struct FramesMemory {
  static constexpr const char* kName = "frames";
  static constexpr std::size_t kMostBuses = 16;  // frames of further buses are copied but not counted
  static constexpr std::size_t kDepth = 4096;
  using Ring = RingMemory<FrameRecord, kDepth>;

  Header header;
  StickyWord wanted_until_ns;  // CLOCK_MONOTONIC; a monitor sets it one second ahead, repeatedly
  std::array<BusCounts, kMostBuses> buses;
  Ring ring;
};

}  // namespace lithe::ipc
