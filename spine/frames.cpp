// SPDX-License-Identifier: Apache-2.0
#include "spine/frames.hpp"

#include <algorithm>

namespace lithe {

FrameRing::FrameRing(ipc::FramesMemory& memory, const robot::RobotConfig& robot, const RawClock& clock)
    : memory_(memory), ring_(memory.ring), clock_(clock) {
  for (std::size_t i = 0; i < std::min(robot.buses.size(), memory.buses.size()); ++i) {
    const std::string& name = robot.buses[i].name;
    std::copy_n(name.begin(), std::min(name.size(), memory.buses[i].name.size() - 1), memory.buses[i].name.begin());
  }
}

bool FrameRing::wanted(std::int64_t now_ns) LITHE_RT {
  // relaxed: it is only the time of a request; no other data depends on it.
  const std::uint64_t until_ns = ipc::load_word(memory_.wanted_until_ns.value, std::memory_order_relaxed);
  if (until_ns < static_cast<std::uint64_t>(now_ns)) return false;
  // Once an exchange: each of its buses asks, with the same time, while the clock goes on.
  if (now_ns != begun_ns_) offset_ns_ = now_ns - clock_.now_ns();
  begun_ns_ = now_ns;
  return true;
}

void FrameRing::saw(std::uint32_t bus, bool outbound, const hal::Frame& frame) LITHE_RT {
  ipc::FrameRecord record;
  record.time_ns = clock_.now_ns() + offset_ns_;
  record.id = frame.id;
  record.bus = static_cast<std::uint8_t>(bus);
  record.size = static_cast<std::uint8_t>(frame.payload().size());
  record.flags = static_cast<std::uint8_t>(
      (outbound ? ipc::frame_flag::kOutbound : 0) | (frame.extended ? ipc::frame_flag::kExtended : 0) |
      (frame.fd ? ipc::frame_flag::kFd : 0) | (frame.brs ? ipc::frame_flag::kBrs : 0));
  record.data = frame.data;
  ring_.push(record);
}

void FrameRing::counted(std::uint32_t bus, const hal::BusStatistics& n) LITHE_RT {
  if (bus >= memory_.buses.size()) return;
  ipc::BusCounts& counts = memory_.buses[bus];
  // relaxed: each word by itself.
  const auto tell = [](std::uint64_t& word, std::uint64_t value)
                        LITHE_RT { ipc::store_word(word, value, std::memory_order_relaxed); };
  tell(counts.sent, n.sent);
  tell(counts.received, n.received);
  tell(counts.refused, n.refused);
  tell(counts.late, n.late);
  tell(counts.malformed, n.malformed);
  tell(counts.errors, n.errors);
  tell(counts.reopened, n.reopened);
}

}  // namespace lithe
