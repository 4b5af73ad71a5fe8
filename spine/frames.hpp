// SPDX-License-Identifier: Apache-2.0
// Copies the frames of the buses into shared memory while a monitor asks for them.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/core/tap.hpp"
#include "spine/ipc/frames.hpp"
#include "spine/robot/config.hpp"

namespace lithe {

// Contract: as hal::FrameTap · the only writer of the segment · a watcher can make it record, and nothing else
class FrameRing final : public hal::FrameTap {
 public:
  FrameRing(ipc::FramesMemory& memory, const robot::RobotConfig& robot, const RawClock& clock);

  bool wanted(std::int64_t now_ns) LITHE_RT override;
  void saw(std::uint32_t bus, bool outbound, const hal::Frame& frame) LITHE_RT override;
  void counted(std::uint32_t bus, const hal::BusStatistics& statistics) LITHE_RT override;

 private:
  ipc::FramesMemory& memory_;
  ipc::RingWriter<ipc::FrameRecord, ipc::FramesMemory::kDepth> ring_;
  RawClock clock_;
  std::int64_t begun_ns_ = 0;   // this exchange
  std::int64_t offset_ns_ = 0;  // of CLOCK_MONOTONIC against our clock, as of this exchange
};

}  // namespace lithe
