// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::canopen {

Frame blank(std::uint32_t id, std::size_t size) LITHE_RT {
  Frame frame;
  frame.id = id;
  frame.size = static_cast<std::uint8_t>(size);
  return frame;
}

Frame nmt_frame(NmtCommand command, std::uint32_t node) LITHE_RT {
  Frame frame = blank(cob::kNmt, 2);
  frame.data[0] = static_cast<std::uint8_t>(command);
  frame.data[1] = static_cast<std::uint8_t>(node);
  return frame;
}

Frame sync_frame() LITHE_RT { return blank(cob::kSync, 0); }

Frame heartbeat_frame(std::uint32_t node, NmtState state) LITHE_RT {
  Frame frame = blank(cob::kHeartbeat + node, 1);
  frame.data[0] = static_cast<std::uint8_t>(state);
  return frame;
}

Frame emergency_frame(std::uint32_t node, const Emergency& what) LITHE_RT {
  Frame frame = blank(cob::kEmergency + node, 8);
  put_little_endian(frame.data.data(), what.code, 2);
  frame.data[2] = what.error_register;
  return frame;
}

bool parse_heartbeat(const Frame& frame, NmtState& state) LITHE_RT {
  if (!is_canopen(frame) || function_of(frame) != cob::kHeartbeat || frame.size != 1) return false;
  const auto said = static_cast<NmtState>(frame.data[0] & 0x7f);  // bit 7 toggles in node guarding
  const bool known = said == NmtState::boot_up || said == NmtState::stopped || said == NmtState::operational ||
                     said == NmtState::pre_operational;
  if (known) state = said;
  return known;
}

bool parse_emergency(const Frame& frame, Emergency& what) LITHE_RT {
  if (!is_canopen(frame) || function_of(frame) != cob::kEmergency || node_of(frame) == 0 || frame.size != 8)
    return false;
  what.code = static_cast<std::uint16_t>(little_endian(frame.data.data(), 2));
  what.error_register = frame.data[2];
  return true;
}

bool HeartbeatProducer::due(std::int64_t now_ns) LITHE_RT {
  if (period_ns_ <= 0 || (started_ && now_ns < next_ns_)) return false;
  // Keeps the grid of the first heartbeat, except after a long pause.
  next_ns_ = started_ && now_ns - next_ns_ < period_ns_ ? next_ns_ + period_ns_ : now_ns + period_ns_;
  started_ = true;
  return true;
}

}  // namespace lithe::hal::canopen
