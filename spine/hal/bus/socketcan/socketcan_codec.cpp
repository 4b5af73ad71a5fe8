// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/socketcan/socketcan_codec.hpp"

#include <linux/can/error.h>

#include <algorithm>
#include <cstring>

namespace lithe::hal::socketcan {
std::size_t encode(const Frame& frame, canfd_frame& out) LITHE_RT {
  if (!is_can(frame)) return 0;
  out = canfd_frame{};
  out.can_id = frame.id | (frame.extended ? CAN_EFF_FLAG : 0U);
  out.len = frame.size;
  out.flags = frame.brs ? CANFD_BRS : 0;
  std::copy_n(frame.data.begin(), frame.size, out.data);
  return frame.fd ? CANFD_MTU : CAN_MTU;
}

Kind decode(std::span<const std::byte> bytes, Frame& frame) LITHE_RT {
  const bool fd = bytes.size() == CANFD_MTU;
  if (!fd && bytes.size() != CAN_MTU) return Kind::malformed;
  canfd_frame raw{};
  std::memcpy(&raw, bytes.data(), bytes.size());
  if ((raw.can_id & CAN_ERR_FLAG) != 0) {
    if ((raw.can_id & CAN_ERR_RESTARTED) != 0) return Kind::restarted;
    return (raw.can_id & CAN_ERR_BUSOFF) != 0 ? Kind::bus_off : Kind::error;
  }
  if ((raw.can_id & CAN_RTR_FLAG) != 0) return Kind::remote;
  Frame heard;
  heard.extended = (raw.can_id & CAN_EFF_FLAG) != 0;
  heard.id = raw.can_id & CAN_EFF_MASK;
  heard.size = raw.len;
  heard.fd = fd;
  heard.brs = fd && (raw.flags & CANFD_BRS) != 0;
  if (!is_can(heard)) return Kind::malformed;
  std::copy_n(raw.data, heard.size, heard.data.begin());
  frame = heard;
  return Kind::frame;
}

}  // namespace lithe::hal::socketcan
