// SPDX-License-Identifier: Apache-2.0
// The parts of CANopen (CiA 301) common to all nodes: identifiers, network states, heartbeats, SYNC, emergencies. Pure:
// frames in, values out; no I/O. All numbers little-endian.
//
//   id          who sends  what                                 data
//   000         master     NMT: go into a state                 command, node (0 = all)
//   080         master     SYNC: sample and apply, now          none, or a counter
//   080 + node  node       emergency                            u16 code, u8 error register, 5 bytes of the maker
//   180 + node  node       first process data to the master     as mapped; 280, 380, 480: second to fourth
//   200 + node  master     first process data to the node       as mapped; 300, 400, 500: second to fourth
//   580 + node  node       answer to an SDO request             canopen_sdo.hpp
//   600 + node  master     SDO request: read or write an object
//   700 + node  node       heartbeat                            u8 state
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::canopen {

namespace cob {
inline constexpr std::uint32_t kNmt = 0x000;
inline constexpr std::uint32_t kSync = 0x080;
inline constexpr std::uint32_t kEmergency = 0x080;
inline constexpr std::uint32_t kTpdo1 = 0x180;
inline constexpr std::uint32_t kRpdo1 = 0x200;
inline constexpr std::uint32_t kNextPdo = 0x100;  // id distance between PDOs of one direction
inline constexpr std::uint32_t kSdoAnswer = 0x580;
inline constexpr std::uint32_t kSdoRequest = 0x600;
inline constexpr std::uint32_t kHeartbeat = 0x700;
inline constexpr std::uint32_t kNode = 0x07f;      // the node's part of an id
inline constexpr std::uint32_t kFunction = 0x780;  // what is left
// In objects 1400h and 1800h, bit 31 of an id switches the PDO off. In 1800h, bit 30 means "no remote frames": drives
// without remote frames refuse an id without that bit.
inline constexpr std::uint32_t kOff = 0x8000'0000;
inline constexpr std::uint32_t kNoRemote = 0x4000'0000;
}  // namespace cob

// Objects of the communication profile, by index.
namespace object {
inline constexpr std::uint16_t kDeviceType = 0x1000;
inline constexpr std::uint16_t kErrorRegister = 0x1001;
inline constexpr std::uint16_t kSyncId = 0x1005;
inline constexpr std::uint16_t kSyncPeriodUs = 0x1006;
inline constexpr std::uint16_t kDeviceName = 0x1008;
inline constexpr std::uint16_t kEmergencyId = 0x1014;
inline constexpr std::uint16_t kConsumerHeartbeat = 0x1016;  // :1 = node << 16 | milliseconds
inline constexpr std::uint16_t kProducerHeartbeatMs = 0x1017;
inline constexpr std::uint16_t kIdentity = 0x1018;
inline constexpr std::uint16_t kErrorBehaviour = 0x1029;
inline constexpr std::uint16_t kRpdo1 = 0x1400;  // :1 id, :2 transmission type; 1401h second
inline constexpr std::uint16_t kRpdo1Mapping = 0x1600;
inline constexpr std::uint16_t kTpdo1 = 0x1800;
inline constexpr std::uint16_t kTpdo1Mapping = 0x1a00;
}  // namespace object

// Codes of an emergency. The high byte is its class.
namespace emergency {
inline constexpr std::uint16_t kGone = 0x0000;  // "error reset": earlier errors have ended
inline constexpr std::uint16_t kOverCurrent = 0x2310;
inline constexpr std::uint16_t kOverVoltage = 0x3210;
inline constexpr std::uint16_t kUnderVoltage = 0x3220;
inline constexpr std::uint16_t kTooHot = 0x4210;
inline constexpr std::uint16_t kSensor = 0x7300;
inline constexpr std::uint16_t kHeartbeatLost = 0x8130;
inline constexpr std::uint16_t kPdoTooShort = 0x8210;
inline constexpr std::uint16_t kFollowingError = 0x8611;
}  // namespace emergency

enum class NmtCommand : std::uint8_t {
  start = 0x01,
  stop = 0x02,
  enter_pre_operational = 0x80,
  reset_node = 0x81,
  reset_communication = 0x82,
};

enum class NmtState : std::uint8_t { boot_up = 0x00, stopped = 0x04, operational = 0x05, pre_operational = 0x7f };

struct Emergency {
  std::uint16_t code = 0;
  std::uint8_t error_register = 0;
};

constexpr std::uint32_t function_of(const Frame& frame) LITHE_RT { return frame.id & cob::kFunction; }
constexpr std::uint32_t node_of(const Frame& frame) LITHE_RT { return frame.id & cob::kNode; }
// The node that sent a frame; 0, which no node has, for one that is not CANopen.
constexpr std::uint32_t sender_of(const Frame& frame) LITHE_RT { return frame.extended ? 0 : node_of(frame); }

// True for a frame with an 11-bit id and at most 8 bytes.
constexpr bool is_canopen(const Frame& frame) LITHE_RT {
  return !frame.extended && !frame.fd && frame.id <= 0x7ff && frame.size <= 8;
}

// A frame of zeros of that length (0 to 8).
Frame blank(std::uint32_t id, std::size_t size) LITHE_RT;
Frame nmt_frame(NmtCommand command, std::uint32_t node) LITHE_RT;
Frame sync_frame() LITHE_RT;
Frame heartbeat_frame(std::uint32_t node, NmtState state) LITHE_RT;
Frame emergency_frame(std::uint32_t node, const Emergency& what) LITHE_RT;

// False: not such a frame; the value is unchanged.
bool parse_heartbeat(const Frame& frame, NmtState& state) LITHE_RT;
bool parse_emergency(const Frame& frame, Emergency& what) LITHE_RT;

// Heartbeat producer: once per period, the first time at once.
// Contract: RT · one thread · time is an argument
class HeartbeatProducer {
 public:
  explicit HeartbeatProducer(std::int64_t period_ns = 0) : period_ns_(period_ns) {}

  void set_period(std::int64_t period_ns) LITHE_RT { *this = HeartbeatProducer(period_ns); }  // 0: silent
  // True when a heartbeat is due; the next one is then one period later. Missed ones are not sent later.
  bool due(std::int64_t now_ns) LITHE_RT;

 private:
  std::int64_t period_ns_;
  std::int64_t next_ns_ = 0;
  bool started_ = false;
};

// Heartbeat consumer: watches another node, beginning with its first heartbeat (CiA 301).
// Contract: as HeartbeatProducer
class HeartbeatConsumer {
 public:
  void set_timeout(std::int64_t timeout_ns) LITHE_RT {  // 0: does not watch
    timeout_ns_ = timeout_ns;
    watching_ = false;
  }
  void received(std::int64_t now_ns) LITHE_RT {
    last_ns_ = now_ns;
    watching_ = timeout_ns_ > 0;
  }
  // Deadline of the next heartbeat; the largest number while it does not watch.
  std::int64_t deadline_ns() const LITHE_RT {
    return watching_ ? last_ns_ + timeout_ns_ : std::numeric_limits<std::int64_t>::max();
  }
  // True once each time the heartbeats stop.
  bool lost(std::int64_t now_ns) LITHE_RT {
    if (now_ns < deadline_ns()) return false;
    watching_ = false;
    return true;
  }

 private:
  std::int64_t timeout_ns_ = 0;
  std::int64_t last_ns_ = 0;
  bool watching_ = false;
};

}  // namespace lithe::hal::canopen
