// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia401/sim/sim_cia401.hpp"

#include <cmath>
#include <numbers>

#include "spine/hal/canopen/canopen_pdo.hpp"

namespace lithe::hal::sim {

using canopen::Address;
using canopen::NmtState;
namespace common = canopen::object;
namespace code = canopen::abort_code;
namespace cob = canopen::cob;
namespace object = cia401::object;

namespace {

constexpr std::uint32_t kDeviceType = 0x0005'0000 | cia401::kDeviceProfile;  // digital and analog inputs
constexpr double kAmplitude = 1000;
constexpr std::uint8_t kEventTimerMs = 5;

}  // namespace

SimCia401::SimCia401(std::uint32_t node, const cia401::Inputs& inputs) : SdoServer(node, objects_), node_(node) {
  objects_.add(common::kDeviceType, 0, 4, kReadOnly, kDeviceType);
  objects_.add(common::kProducerHeartbeatMs, 0, 2, kWritable, 0);
  objects_.add(common::kIdentity, 0, 1, kReadOnly, 4);
  for (std::uint8_t i = 1; i <= 4; ++i)
    objects_.add(common::kIdentity, i, 4, kReadOnly, i == 2 ? 0x401U : i == 4 ? node : 0U);
  for (std::uint16_t i = 0; i < cia401::kPdos; ++i) {
    objects_.add(common::kTpdo1 + i, 0, 1, kReadOnly, 5);
    objects_.add(common::kTpdo1 + i, 1, 4, kWritable, cob::kOff | cia401::pdo_id(i, node));
    objects_.add(common::kTpdo1 + i, 2, 1, kWritable, 255);
    objects_.add(common::kTpdo1 + i, kEventTimerMs, 2, kWritable, 0);
    for (std::uint8_t n = 0; n <= canopen::PdoMap::kMost; ++n)
      objects_.add(common::kTpdo1Mapping + i, n, n == 0 ? 1 : 4, kWritable, 0);
  }
  for (std::uint32_t i = 0; 8 * i < inputs.digital; ++i)
    objects_.add(object::kDigitalInputs, static_cast<std::uint8_t>(1 + i), 1, kReadOnly, 0);
  for (std::uint32_t i = 0; i < inputs.analog; ++i)
    objects_.add(object::kAnalogInputs, static_cast<std::uint8_t>(1 + i), 2, kReadOnly, 0);
  objects_.add(object::kAnalogInterrupt, 0, 1, kWritable, 0);
}

void SimCia401::restart(std::int64_t back_ns) LITHE_RT {
  state_ = NmtState::boot_up;
  boot_ns_ = back_ns;
  heartbeat_.set_period(0);
  objects_.restore(true);
  forget_upload();
}

bool SimCia401::inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT {
  if (injected == InjectedFault::other_map) {
    other_map_ = begins;
    return true;
  }
  if (injected != InjectedFault::power_loss) return false;
  if (begins) restart(now_ns + kPowerLossNs);
  return true;
}

void SimCia401::on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  on_time(now_ns, answers);
  if (!canopen::is_canopen(frame) || state_ == NmtState::boot_up || muted_) return;
  if (frame.id == cob::kNmt) return handle(frame, now_ns);
  if (frame.id == cob::kSdoRequest + node_ && state_ != NmtState::stopped) {
    if (Frame answer; serve(frame, answer)) answers.push(answer);
  }
}

void SimCia401::handle(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  if (frame.size != 2 || (frame.data[1] != 0 && frame.data[1] != node_)) return;
  using enum canopen::NmtCommand;
  const auto command = static_cast<canopen::NmtCommand>(frame.data[0]);
  if (command == start) state_ = NmtState::operational;
  if (command == start) sent_ns_.fill(now_ns);
  if (command == stop) state_ = NmtState::stopped;
  if (command == enter_pre_operational) state_ = NmtState::pre_operational;
  if (command == reset_node || command == reset_communication) restart(now_ns + kBootNs);
}

// A mapping is changed only while its PDO is off, and names only objects that are there.
std::uint32_t SimCia401::write_object(ObjectDictionary::Slot slot, std::uint32_t value) LITHE_RT {
  const Address address = objects_.address(slot);
  if (address.index >= common::kTpdo1Mapping && address.index < common::kTpdo1Mapping + cia401::kPdos) {
    const auto communication = static_cast<std::uint16_t>(address.index - common::kTpdo1Mapping + common::kTpdo1);
    if ((objects_.value(communication, 1) & cob::kOff) == 0) return code::kUnsupportedAccess;
    if (address.subindex == 0 && value > canopen::PdoMap::kMost) return code::kPdoTooLong;
    const auto mapped = objects_.find({static_cast<std::uint16_t>(value >> 16), static_cast<std::uint8_t>(value >> 8)});
    if (address.subindex > 0 && !mapped) return code::kNoObject;
    if (address.subindex > 0 && objects_.bytes(*mapped) * 8U != (value & 0xff)) return code::kNotMappable;
  }
  objects_.set_raw(slot, value);
  if (address.index == common::kProducerHeartbeatMs) heartbeat_.set_period(std::int64_t{value} * 1'000'000);
  return code::kNone;
}

void SimCia401::on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  if (boot_ns_ == 0) boot_ns_ = now_ns + kBootNs;
  if (start_ns_ == 0) start_ns_ = now_ns;
  if (muted_) return;
  if (state_ == NmtState::boot_up) {
    if (now_ns < boot_ns_) return;
    state_ = NmtState::pre_operational;
    answers.push(canopen::heartbeat_frame(node_, NmtState::boot_up));
    return;
  }
  if (heartbeat_.due(now_ns)) answers.push(canopen::heartbeat_frame(node_, state_));
  if (state_ != NmtState::operational) return;
  for (std::size_t pdo = 0; pdo < cia401::kPdos; ++pdo) send_inputs(pdo, now_ns, answers);
}

void SimCia401::send_inputs(std::size_t pdo, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  const auto communication = static_cast<std::uint16_t>(common::kTpdo1 + pdo);
  const auto mapping = static_cast<std::uint16_t>(common::kTpdo1Mapping + pdo);
  const std::uint32_t id = objects_.value(communication, 1);
  const std::int64_t every_ns = std::int64_t{objects_.value(communication, kEventTimerMs)} * 1'000'000;
  if ((id & cob::kOff) != 0 || every_ns == 0 || now_ns - sent_ns_[pdo] < every_ns) return;
  sent_ns_[pdo] = now_ns;
  Frame frame = canopen::blank(id & kLargestStandardId, 0);
  const std::uint32_t count = objects_.value(mapping, 0);
  for (std::uint32_t i = 1; i <= count; ++i) {
    const std::uint32_t entry = objects_.value(mapping, static_cast<std::uint8_t>(i));
    const Address address{static_cast<std::uint16_t>(entry >> 16), static_cast<std::uint8_t>(entry >> 8)};
    const std::size_t bytes = (entry & 0xff) / 8;
    if (address.index == object::kAnalogInputs && objects_.value(object::kAnalogInterrupt, 0) == 0) return;
    if (frame.size + bytes > 8) break;
    put_little_endian(frame.data.data() + frame.size, input(address, now_ns), bytes);
    frame.size = static_cast<std::uint8_t>(frame.size + bytes);
  }
  if (other_map_ && frame.size > 0) --frame.size;
  answers.push(frame);
}

std::uint32_t SimCia401::input(Address address, std::int64_t now_ns) const LITHE_RT {
  const double time_s = 1e-9 * static_cast<double>(now_ns - start_ns_);
  const std::uint32_t first = address.subindex - 1U;
  if (address.index == object::kAnalogInputs) {
    const double swing = std::sin(2 * std::numbers::pi * time_s + first);
    return static_cast<std::uint16_t>(std::lround(kAmplitude * swing));
  }
  std::uint32_t bits = 0;
  for (std::uint32_t bit = 0; bit < 8; ++bit) {
    const auto half_periods = static_cast<std::uint32_t>(time_s / 30 * static_cast<double>(1U << (8 * first + bit)));
    bits |= (half_periods & 1) << bit;
  }
  return bits;
}

SimDevice make_sim_cia401(const SimPlace& place) {
  return {std::make_unique<SimCia401>(place.device.id, place.device.keys.cia401.inputs)};
}

}  // namespace lithe::hal::sim
