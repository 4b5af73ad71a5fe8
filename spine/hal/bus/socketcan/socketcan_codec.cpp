// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/socketcan/socketcan_codec.hpp"

#include <linux/can/error.h>

#include <algorithm>
#include <cstring>

namespace lithe::hal::socketcan {
namespace {

void count(const canfd_frame& raw, Troubles& troubles) LITHE_RT {
  const canid_t kinds = raw.can_id & CAN_ERR_MASK;
  const std::uint8_t controller = (kinds & CAN_ERR_CRTL) != 0 ? raw.data[1] : std::uint8_t{0};
  const auto add = [](std::uint64_t& counter, bool happened) LITHE_RT { counter += happened ? 1 : 0; };
  add(troubles.bus_off, (kinds & CAN_ERR_BUSOFF) != 0);
  add(troubles.restarted, (kinds & CAN_ERR_RESTARTED) != 0);
  add(troubles.passive, (controller & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0);
  add(troubles.warning, (controller & (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0);
  add(troubles.overflow, (controller & (CAN_ERR_CRTL_RX_OVERFLOW | CAN_ERR_CRTL_TX_OVERFLOW)) != 0);
  add(troubles.unacknowledged, (kinds & CAN_ERR_ACK) != 0);
  add(troubles.arbitration, (kinds & CAN_ERR_LOSTARB) != 0);
  add(troubles.violations, (kinds & (CAN_ERR_PROT | CAN_ERR_BUSERROR)) != 0);
  add(troubles.timeouts, (kinds & CAN_ERR_TX_TIMEOUT) != 0);
  add(troubles.transceiver, (kinds & CAN_ERR_TRX) != 0);
}

}  // namespace

std::size_t encode(const Frame& frame, canfd_frame& out) LITHE_RT {
  if (!is_can(frame)) return 0;
  out = canfd_frame{};
  out.can_id = frame.id | (frame.extended ? CAN_EFF_FLAG : 0U);
  out.len = frame.size;
  out.flags = frame.brs ? CANFD_BRS : 0;
  std::copy_n(frame.data.begin(), frame.size, out.data);
  return frame.fd ? CANFD_MTU : CAN_MTU;
}

Kind decode(std::span<const std::byte> bytes, Frame& frame, Troubles& troubles) LITHE_RT {
  const bool fd = bytes.size() == CANFD_MTU;
  if (!fd && bytes.size() != CAN_MTU) return Kind::malformed;
  canfd_frame raw{};
  std::memcpy(&raw, bytes.data(), bytes.size());
  if ((raw.can_id & CAN_ERR_FLAG) != 0) {
    count(raw, troubles);
    return Kind::error;
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
