// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus_actuators.hpp"

#include <algorithm>
#include <cstring>
#include <limits>
#include <utility>

#include "spine/hal/core/descriptor.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

JointCommand joint_command(const ActuatorCommand& all, std::size_t joint) LITHE_RT {
  if (joint >= all.joints) return {};  // a joint without a command is off
  return {pd_of(all, joint), all.action[joint], all.max_torque_nm[joint], all.clear_faults};
}

// Hash of a frame's content (FNV-1a, eight bytes at a time).
std::uint64_t digest_of(const Frame& frame) LITHE_RT {
  std::uint64_t digest = 0xcbf29ce484222325;
  const std::size_t size = frame.payload().size();
  for (std::size_t at = 0; at < size; at += sizeof(std::uint64_t)) {
    std::uint64_t word = 0;
    std::memcpy(&word, frame.data.data() + at, std::min(sizeof word, size - at));
    digest = (digest ^ word) * 0x100000001b3;
    digest ^= digest >> 32;
  }
  return digest;
}

}  // namespace

std::size_t BusActuators::add_bus(std::unique_ptr<Bus> bus, SenderOf sender_of, std::unique_ptr<BusMaster> master) {
  Line line{std::move(bus), std::move(master), sender_of, 0, 0, 0, 0, {}};
  line.joint_at.fill(kNoJoint);
  lines_.push_back(std::move(line));
  return lines_.size() - 1;
}

void BusActuators::add_joint(std::size_t bus, std::uint32_t address, std::unique_ptr<Drive> drive,
                             std::uint32_t divider) {
  lines_[bus].joint_at[address & 0x7f] = static_cast<std::uint8_t>(joints_.size());
  // A bus with a master has one SYNC for all its drives: they are asked together.
  const std::uint32_t turn = lines_[bus].master != nullptr ? 0 : lines_[bus].joints % divider;
  ++lines_[bus].joints;
  joints_.push_back({bus, std::move(drive), divider, turn});
  last_.joints = static_cast<std::uint32_t>(joints_.size());
}

std::size_t BusActuators::add_sensors(std::size_t bus, std::unique_ptr<SensorDevice> device) {
  sensor_places_.push_back({bus, std::move(device)});
  ++lines_[bus].sensor_devices;
  return sensor_places_.size() - 1;
}

void BusActuators::add_sensor(std::size_t device, Block block, std::size_t channel, double scale, double offset) {
  sensors_.push_back({device, block, channel, scale, offset});
}

void BusActuators::cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT {
  ++exchange_.number;
  exchange_.now_ns = now_ns;
  exchange_.source = static_cast<std::uint32_t>(exchange_.number % kSources);
  exchange_.asked = false;
  for (Line& line : lines_) {
    line.bus->begin(now_ns);
    line.patience = kMostWaiting;
    drain(line);  // frames since the last exchange: unsolicited ones, and late answers
  }
  send_all(command);  // send on all buses first: the answers then travel in parallel
  exchange_.asked = true;
  collect();
  settle();
  last_.tick = command.tick;
  last_.sample_ns = now_ns;
  state.tick = last_.tick;
  state.sample_ns = last_.sample_ns;
  state.joints = last_.joints;
  state.bus_ns = 0;  // measured by the caller, who has the clock
  std::copy_n(last_.position_rad.begin(), last_.joints, state.position_rad.begin());
  std::copy_n(last_.velocity_rad_s.begin(), last_.joints, state.velocity_rad_s.begin());
  std::copy_n(last_.torque_nm.begin(), last_.joints, state.torque_nm.begin());
  std::copy_n(last_.status.begin(), last_.joints, state.status.begin());
  std::copy_n(last_.drive.begin(), last_.joints, state.drive.begin());
  read_sensors(state);
}

void BusActuators::send_all(const ActuatorCommand& command) LITHE_RT {
  for (Line& line : lines_) {
    line.unanswered = 0;
    line.patience = 4 * line.joints + 16 * line.sensor_devices + 16;
    if (line.master != nullptr) line.master->before_commands(exchange_, *line.bus);
  }
  for (SensorPlace& place : sensor_places_) place.device->step(exchange_, *lines_[place.line].bus);
  for (std::size_t i = 0; i < joints_.size(); ++i) {
    Joint& joint = joints_[i];
    joint.asked = exchange_.number % joint.divider == joint.turn;
    if (!joint.asked) continue;
    joint.heard = joint.answered = false;
    Line& line = lines_[joint.line];
    // A lost drive is always asked but rarely waited for: waiting would delay the samples of the other joints.
    joint.awaited = joint.misses_in_a_row < misses_to_lost_ || exchange_.number / joint.divider % kLookForLost == 0;
    if (joint.awaited) {
      ++line.unanswered;
      line.bus->expect_answer();
    }
    if (!joint.drive->command(joint_command(command, i), exchange_, *line.bus)) ++counters_.unsound;
  }
  for (Line& line : lines_) {
    if (line.master != nullptr) line.master->after_commands(exchange_, *line.bus);
    line.bus->flush();
  }
}

// Waits until every asked joint has answered, or the time of its bus is over. All buses are waited for at once.
void BusActuators::collect() LITHE_RT {
  const std::int64_t from_ns = clock_.now_ns();
  for (bool waiting = true; waiting;) {
    waiting = false;
    for (Line& line : lines_) {
      drain(line);
      const bool may_come = line.unanswered > 0 && line.patience > 0 && line.bus->reply_wait_ns() > 0;
      waiting |= may_come && clock_.now_ns() - from_ns < line.bus->reply_wait_ns();
    }
    if (waiting) shares_core_ ? nap() : spin_pause();
  }
}

void BusActuators::drain(Line& line) LITHE_RT {
  Frame frame;
  for (; line.patience > 0 && line.bus->receive(frame); --line.patience) accept(line, frame);
}

bool BusActuators::accept_sensors(const Line& line, const Frame& frame) LITHE_RT {
  for (SensorPlace& place : sensor_places_) {
    if (&lines_[place.line] != &line || !place.device->sent(frame)) continue;
    place.device->on_frame(frame, exchange_.now_ns);
    return true;
  }
  return false;
}

void BusActuators::read_sensors(ActuatorState& state) const LITHE_RT {
  state.sensors = static_cast<std::uint32_t>(sensors_.size());
  for (std::size_t i = 0; i < sensors_.size(); ++i) {
    const Sensor& sensor = sensors_[i];
    const SensorDevice& device = *sensor_places_[sensor.place].device;
    double raw = 0;
    const bool valid = device.read(sensor.block, sensor.channel, exchange_.now_ns, raw);
    state.sensor[i] = valid ? sensor.scale * raw + sensor.offset : std::numeric_limits<double>::quiet_NaN();
  }
}

void BusActuators::accept(Line& line, const Frame& frame) LITHE_RT {
  if (accept_sensors(line, frame)) return;
  const std::uint32_t address = line.sender_of != nullptr ? line.sender_of(frame) : 0;
  const std::uint8_t index = address < line.joint_at.size() ? line.joint_at[address] : kNoJoint;
  if (index == kNoJoint) {
    ++counters_.stray;
    return;
  }
  Joint& joint = joints_[index];
  JointSample sample;
  const ReplyKind kind = joint.drive->on_frame(frame, exchange_, sample);
  if (kind == ReplyKind::answer && joint.asked) return answer(line, joint, index, frame, sample);
  if (kind == ReplyKind::malformed) {
    ++malformed_answers_;
    joint.garbled = true;
  } else if (kind != ReplyKind::part) {  // late, or not asked by us
    ++late_answers_;
    compare(joint, frame);  // the slower of two devices answers after the wait
  }
}

void BusActuators::answer(Line& line, Joint& joint, std::size_t index, const Frame& frame, const JointSample& sample)
    LITHE_RT {
  // An answer without a measurement also ends the wait.
  if (!joint.heard && joint.asked && joint.awaited) --line.unanswered;
  joint.heard = true;
  if (joint.answered) {
    ++repeated_answers_;
    return compare(joint, frame);
  }
  if (!sample.measured) {  // use the drive's state, not its measurement
    last_.status[index] = sample.status;
    last_.drive[index] = sample.drive;
    ++malformed_answers_;
    joint.garbled = true;
    return;
  }
  joint.answered = true;
  joint.sample = sample;
  joint.said_id = frame.id;
  joint.said = digest_of(frame);
}

// The id of a moteus answer shows which command it belongs to. A CANopen answer does not: a repeated old one looks like
// an answer of a second device.
void BusActuators::compare(Joint& joint, const Frame& frame) LITHE_RT {
  if (joint.answered && frame.id == joint.said_id && digest_of(frame) != joint.said) joint.contradicted = true;
}

// A joint that was not asked keeps its sample and its `fresh` bit.
void BusActuators::settle() LITHE_RT {
  for (std::size_t i = 0; i < joints_.size(); ++i)
    if (joints_[i].asked) settle(joints_[i], i);
  counters_.late = late_answers_;
  counters_.duplicate = repeated_answers_;
  counters_.malformed = malformed_answers_;
  counters_.refused = 0;
  for (const SensorPlace& place : sensor_places_) {
    counters_.duplicate += place.device->repeated();
    counters_.malformed += place.device->malformed();
  }
  for (const Line& line : lines_) {
    counters_.late += line.bus->statistics().late;
    counters_.refused += line.bus->statistics().refused;
  }
}

// The answer of a second device comes in this exchange, or before the joint is asked again.
void BusActuators::settle(Joint& joint, std::size_t index) LITHE_RT {
  if (joint.contradicted) {
    ++counters_.conflicting;
    joint.conflicts_in_a_row = std::min(joint.conflicts_in_a_row + 1, misses_to_lost_);
    joint.sound_in_a_row = 0;
  } else if (joint.answered && (joint.conflicts_in_a_row < misses_to_lost_ || ++joint.sound_in_a_row >= kSoundAgain)) {
    joint.conflicts_in_a_row = joint.sound_in_a_row = 0;
  }
  if (joint.answered && !joint.contradicted)
    settle_answer(joint, index);
  else
    settle_miss(joint, index);
  joint.contradicted = false;
  if (joint.conflicts_in_a_row == misses_to_lost_) last_.status[index] |= wire::joint_status::kConflict;
}

void BusActuators::settle_answer(Joint& joint, std::size_t index) LITHE_RT {
  joint.misses_in_a_row = 0;
  joint.garbled = false;
  last_.status[index] = joint.sample.status | wire::joint_status::kFresh;
  last_.position_rad[index] = joint.sample.position_rad;
  last_.velocity_rad_s[index] = joint.sample.velocity_rad_s;
  last_.torque_nm[index] = joint.sample.torque_nm;
  last_.drive[index] = joint.sample.drive;
}

void BusActuators::settle_miss(Joint& joint, std::size_t index) LITHE_RT {
  ++counters_.missed;
  joint.misses_in_a_row = std::min(joint.misses_in_a_row + 1, misses_to_lost_);
  last_.status[index] &= ~wire::joint_status::kFresh;
  last_.status[index] |= joint.drive->alarm();
  if (joint.misses_in_a_row < misses_to_lost_) return;
  last_.status[index] |= wire::joint_status::kLost | (joint.garbled ? wire::joint_status::kGarbled : 0);
}

}  // namespace lithe::hal
