// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus_actuators.hpp"

#include <algorithm>
#include <utility>

#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

JointCommand joint_command(const ActuatorCommand& all, std::size_t joint) LITHE_RT {
  if (joint >= all.joints) return {};  // a joint nobody commands is off
  return {all.action,           all.torque_nm[joint],   all.position_rad[joint], all.velocity_rad_s[joint],
          all.kp_nm_rad[joint], all.kd_nm_s_rad[joint], all.max_torque_nm[joint]};
}

}  // namespace

std::size_t BusActuators::add_bus(std::unique_ptr<Bus> bus) {
  Line line{std::move(bus), 0, {}};
  line.joint_at.fill(kNobody);
  lines_.push_back(std::move(line));
  return lines_.size() - 1;
}

void BusActuators::add_joint(std::size_t bus, const moteus::DriverParams& params) {
  lines_[bus].joint_at[params.id & 0x7f] = static_cast<std::uint8_t>(joints_.size());
  ++lines_[bus].joints;
  joints_.push_back({bus, moteus::Driver(params)});
  last_.joints = static_cast<std::uint32_t>(joints_.size());
}

void BusActuators::cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT {
  source_ = (source_ + 1) % kSources;
  for (Line& line : lines_) line.bus->begin(now_ns);
  send_all(command);  // to every bus first: their replies travel at the same time
  for (Line& line : lines_) receive_all(line);
  settle();
  last_.tick = command.tick;
  last_.sample_ns = now_ns;
  state.tick = last_.tick;
  state.sample_ns = last_.sample_ns;
  state.joints = last_.joints;
  state.bus_ns = 0;  // whoever owns the clock measures it
  std::copy_n(last_.position_rad.begin(), last_.joints, state.position_rad.begin());
  std::copy_n(last_.velocity_rad_s.begin(), last_.joints, state.velocity_rad_s.begin());
  std::copy_n(last_.torque_nm.begin(), last_.joints, state.torque_nm.begin());
  std::copy_n(last_.status.begin(), last_.joints, state.status.begin());
}

void BusActuators::send_all(const ActuatorCommand& command) LITHE_RT {
  Frame frame;
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    Joint& joint = joints_[i];
    joint.answered = false;
    if (!joint.driver.encode(joint_command(command, i), source_, frame)) ++counters_.unsound;
    lines_[joint.line].bus->send(frame);  // a refusal shows as a missed reply, and is counted
  }
}

void BusActuators::receive_all(Line& line) LITHE_RT {
  // A node that babbles must not keep the tick: twice what is due, then the rest is late.
  std::size_t patience = 2 * line.joints + 8;
  Frame frame;
  while (patience-- > 0 && line.bus->receive(frame)) accept(line, frame);
}

void BusActuators::accept(const Line& line, const Frame& frame) LITHE_RT {
  const std::uint32_t device = moteus::device_of(frame);
  const std::uint8_t index = device < line.joint_at.size() ? line.joint_at[device] : kNobody;
  if (index == kNobody) {
    ++counters_.stray;
    return;
  }
  if (moteus::source_of(frame) != source_) {
    ++late_answers_;
    return;
  }
  Joint& joint = joints_[index];
  if (joint.answered) {
    ++counters_.duplicate;
    return;
  }
  moteus::JointSample sample;
  if (!joint.driver.decode(frame, sample)) {
    ++counters_.malformed;
    return;
  }
  last_.status[index] = moteus::status_of(sample);
  if (!sample.measured) {  // its mode and fault count, its numbers do not
    ++counters_.malformed;
    return;
  }
  joint.answered = true;
  last_.status[index] |= wire::joint_status::kFresh;
  last_.position_rad[index] = sample.position_rad;
  last_.velocity_rad_s[index] = sample.velocity_rad_s;
  last_.torque_nm[index] = sample.torque_nm;
}

void BusActuators::settle() LITHE_RT {
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    Joint& joint = joints_[i];
    if (joint.answered) {
      joint.misses_in_a_row = 0;
      continue;
    }
    ++counters_.missed;
    joint.misses_in_a_row = std::min(joint.misses_in_a_row + 1, kMissesToLost);
    last_.status[i] &= ~wire::joint_status::kFresh;
    if (joint.misses_in_a_row == kMissesToLost) last_.status[i] |= wire::joint_status::kLost;
  }
  counters_.late = late_answers_;
  counters_.refused = 0;
  for (const Line& line : lines_) {
    counters_.late += line.bus->statistics().late;
    counters_.refused += line.bus->statistics().refused;
  }
}

}  // namespace lithe::hal
