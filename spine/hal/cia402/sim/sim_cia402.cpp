// SPDX-License-Identifier: Apache-2.0
// Network states, heartbeats, emergencies and process data; sim_cia402_objects.cpp serves the dictionary.
#include "spine/hal/cia402/sim/sim_cia402.hpp"

#include <algorithm>

#include "spine/core/time.hpp"
#include "spine/hal/cia402/cia402.hpp"

namespace lithe::hal::sim {

using canopen::NmtCommand;
using canopen::NmtState;
namespace cob = canopen::cob;
namespace common = canopen::object;
namespace emergency = canopen::emergency;
namespace object = cia402::object;

namespace {

constexpr double kMilli = 1000;

Cia402Identity identity_of(const SimCia402Params& params) {
  return {params.id, params.device_type, static_cast<std::uint32_t>(kMilli * params.servo.rated_torque_nm + 0.5),
          static_cast<std::uint32_t>(params.servo.counts_per_rev)};
}

}  // namespace

void SimPdo::rebuild(const Cia402Dictionary& dictionary, std::uint16_t communication, std::uint16_t mapping) LITHE_RT {
  const std::uint32_t said = dictionary.value(communication, 1);
  id_ = said & 0x7ff;
  type_ = static_cast<std::uint8_t>(dictionary.value(communication, 2));
  map_ = {};
  const std::uint32_t count = dictionary.value(mapping, 0);
  for (std::uint32_t i = 0; i < std::min<std::uint32_t>(count, canopen::PdoMap::kMost); ++i) {
    const std::uint32_t entry = dictionary.value(mapping, static_cast<std::uint8_t>(i + 1));
    const canopen::Address address{static_cast<std::uint16_t>(entry >> 16), static_cast<std::uint8_t>(entry >> 8)};
    const auto slot = dictionary.find(address);
    if (!slot || !map_.add({address, dictionary.bytes(*slot)})) break;
    slots_[i] = *slot;
  }
  valid_ = (said & cob::kOff) == 0 && !map_.objects().empty();
  has_waiting = false;
  never_told = true;
}

SimCia402::SimCia402(const SimCia402Params& params)
    : SdoServer(params.id, dictionary_),
      params_(params),
      dictionary_(identity_of(params)),
      servo_(params.servo, params.joint, params.plant, params.errors) {
  reset(true);
}

void SimCia402::reset(bool all) LITHE_RT {
  if (all) servo_.restart();
  dictionary_.restore(all);
  network_state_ = NmtState::boot_up;
  producer_.set_period(0);
  consumer_.set_timeout(0);
  connection_lost_ = false;
  forget_upload();
  booting_ = true;
  boot_end_ns_ = kUnknown;
  errors_told_ = servo_.error_changes();
  rebuild_pdos();
  refresh_inputs();
}

void SimCia402::boot(FrameQueue& answers) LITHE_RT {
  booting_ = false;
  network_state_ = NmtState::pre_operational;
  answers.push(canopen::heartbeat_frame(params_.id, NmtState::boot_up));
  servo_.find_causes();
}

void SimCia402::inject(std::uint16_t code) LITHE_RT {
  if (code == emergency::kGone) return servo_.cause_gone(0);
  servo_.fail(code, true);
}

bool SimCia402::cause(std::uint16_t code, bool begins) LITHE_RT {
  begins ? servo_.fail(code, true) : servo_.cause_gone(code);
  return true;
}

bool SimCia402::inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT {
  constexpr std::int64_t kOutageNs = 100'000'000;
  switch (injected) {
    case InjectedFault::power_loss:
      if (!begins) return true;
      reset(true);  // resets all objects
      boot_end_ns_ = now_ns + kOutageNs + params_.boot_ns;
      return true;
    case InjectedFault::over_temperature:
      return cause(emergency::kTooHot, begins);
    case InjectedFault::encoder_lost:
      return cause(emergency::kSensor, begins);
    case InjectedFault::device_fault:
      return cause(emergency::kOverCurrent, begins);
    case InjectedFault::watchdog_trip:
      host_silent_ = begins;
      return true;
    case InjectedFault::other_map:
      if (other_map_ && !begins) inject(InjectedFault::power_loss, true, now_ns);  // the original device comes back
      other_map_ = begins;
      return true;
    case InjectedFault::homing_lost:
      break;  // it does not report homing
  }
  return false;
}

void SimCia402::live(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  now_ns_ = std::max(now_ns_, now_ns);
  if (booting_) {
    servo_.advance(now_ns_);
    if (boot_end_ns_ == kUnknown) boot_end_ns_ = now_ns_ + params_.boot_ns;
    if (now_ns_ < boot_end_ns_) return;
    return boot(answers);
  }
  const std::int64_t deadline_ns = consumer_.deadline_ns();
  if (deadline_ns <= now_ns_) {  // the reaction happens at the deadline, not now
    servo_.advance(deadline_ns);
    consumer_.lost(now_ns_);
    lose_connection(answers);
  } else if (host_silent_ && network_state_ == NmtState::operational) {
    lose_connection(answers);
  }
  host_silent_ = false;
  servo_.advance(now_ns_);
  tell_news(now_ns_, answers);
}

void SimCia402::lose_connection(FrameQueue& answers) LITHE_RT {
  constexpr std::uint32_t kStay = 1;  // of object 1029h
  constexpr std::uint32_t kStop = 2;
  connection_lost_ = true;
  servo_.connection_lost(dictionary_.signed_value(object::kAbortConnection), emergency::kHeartbeatLost);
  if (servo_.error_changes() == errors_told_) tell_emergency(emergency::kHeartbeatLost, answers);
  const std::uint32_t behaviour = dictionary_.value(common::kErrorBehaviour, 1);
  if (behaviour == kStay || network_state_ != NmtState::operational) return;
  network_state_ = behaviour == kStop ? NmtState::stopped : NmtState::pre_operational;
}

void SimCia402::tell_emergency(std::uint16_t code, FrameQueue& answers) LITHE_RT {
  constexpr std::uint8_t kAnyError = 0x01;
  constexpr std::uint8_t kCommunication = 0x10;
  const bool over = code == emergency::kGone;
  const std::uint8_t error_register = over ? 0 : connection_lost_ ? kAnyError | kCommunication : kAnyError;
  dictionary_.set(common::kErrorRegister, error_register);
  dictionary_.set(object::kErrorCode, code);
  if (network_state_ != NmtState::stopped) answers.push(canopen::emergency_frame(params_.id, {code, error_register}));
}

// Emergencies, heartbeats, and process data that is sent when it changes.
void SimCia402::tell_news(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  if (servo_.error_changes() != errors_told_) {
    errors_told_ = servo_.error_changes();
    tell_emergency(servo_.error_code(), answers);
  }
  if (producer_.due(now_ns)) answers.push(canopen::heartbeat_frame(params_.id, network_state_));
  if (network_state_ != NmtState::operational) return;
  for (std::size_t i = 0; i < kPdos; ++i) {
    SimPdo& pdo = transmit_[i];
    if (!pdo.valid() || pdo.synchronous()) continue;
    const std::uint32_t every_ms = dictionary_.value(static_cast<std::uint16_t>(common::kTpdo1 + i), 5);
    const bool timed = every_ms > 0 && now_ns - pdo.told_ns >= every_ms * kNsPerMs;
    if (pdo.never_told || timed || pdo.told != servo_.statusword()) transmit(pdo, now_ns, answers);
  }
}

void SimCia402::on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  live(now_ns, answers);
  if (booting_) return;
  if (!canopen::is_canopen(frame)) {
    ++refused_;
    return;
  }
  if (frame.id == cob::kNmt) {
    on_nmt(frame);
  } else if (frame.id == dictionary_.value(common::kSyncId)) {
    sync(now_ns_, answers);
  } else if (frame.id == cob::kSdoRequest + params_.id) {
    Frame answer;
    if (network_state_ != NmtState::stopped && serve(frame, answer)) answers.push(answer);
  } else if (canopen::function_of(frame) == cob::kHeartbeat) {
    hear_heartbeat(frame, now_ns_, answers);
  } else {
    on_pdo(frame, answers);
  }
  if (booting_) return live(now_ns, answers);  // a boot time of 0 ends at once
  tell_news(now_ns_, answers);
}

void SimCia402::on_nmt(const Frame& frame) LITHE_RT {
  if (frame.size != 2) {
    ++refused_;
    return;
  }
  if (frame.data[1] != 0 && frame.data[1] != params_.id) return;
  const auto command = static_cast<NmtCommand>(frame.data[0]);
  if (command == NmtCommand::start) {
    network_state_ = NmtState::operational;
    syncs_ = 0;
    for (SimPdo& pdo : transmit_) pdo.never_told = true;
  } else if (command == NmtCommand::stop) {
    if (network_state_ == NmtState::operational)
      servo_.connection_lost(dictionary_.signed_value(object::kAbortConnection), emergency::kHeartbeatLost);
    network_state_ = NmtState::stopped;
  } else if (command == NmtCommand::enter_pre_operational) {
    network_state_ = NmtState::pre_operational;
  } else if (command == NmtCommand::reset_node || command == NmtCommand::reset_communication) {
    reset(command == NmtCommand::reset_node);
  } else {
    ++refused_;
  }
}

void SimCia402::hear_heartbeat(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  NmtState unused{};
  const std::uint32_t watched = dictionary_.value(common::kConsumerHeartbeat, 1) >> 16 & 0x7f;
  if (watched == 0 || canopen::node_of(frame) != watched || !canopen::parse_heartbeat(frame, unused)) return;
  consumer_.received(now_ns);
  if (!connection_lost_) return;
  connection_lost_ = false;
  if (servo_.error_code() == emergency::kGone) tell_emergency(emergency::kGone, answers);
}

// On a SYNC: applies pending RPDOs, then samples.
void SimCia402::sync(std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  if (network_state_ != NmtState::operational) return;
  ++syncs_;
  for (SimPdo& pdo : receive_) {
    if (pdo.has_waiting) apply(pdo, pdo.waiting);
    pdo.has_waiting = false;
  }
  servo_.sync();
  for (SimPdo& pdo : transmit_) {
    if (!pdo.valid() || !pdo.synchronous()) continue;
    const bool changed = pdo.never_told || pdo.told != servo_.statusword();
    if (pdo.every(syncs_) || (!pdo.every(0) && changed)) transmit(pdo, now_ns, answers);
  }
}

void SimCia402::on_pdo(const Frame& frame, FrameQueue& answers) LITHE_RT {
  if (network_state_ != NmtState::operational) return;
  for (SimPdo& pdo : receive_) {
    if (!pdo.valid() || pdo.id() != frame.id) continue;
    if (frame.size < pdo.map().bytes()) {
      ++refused_;
      answers.push(canopen::emergency_frame(params_.id, {emergency::kPdoTooShort, 0x11}));
    } else if (pdo.synchronous()) {
      pdo.waiting = frame;
      pdo.has_waiting = true;
    } else {
      apply(pdo, frame);
      servo_.sync();  // its targets act at once too
    }
  }
}

void SimCia402::apply(const SimPdo& pdo, const Frame& frame) LITHE_RT {
  std::array<std::uint32_t, canopen::PdoMap::kMost> values{};
  if (!pdo.map().unpack(frame, values)) return;
  const std::size_t count = pdo.map().objects().size();
  for (std::size_t i = 0; i < count; ++i)
    if (dictionary_.writable(pdo.slot(i))) dictionary_.set_raw(pdo.slot(i), values[i]);
  refresh_inputs();
  for (std::size_t i = 0; i < count; ++i)
    if (pdo.map().objects()[i].address.index == object::kControlword)
      servo_.control(static_cast<std::uint16_t>(values[i]));
}

void SimCia402::transmit(SimPdo& pdo, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  refresh_actuals();
  std::array<std::uint32_t, canopen::PdoMap::kMost> values{};
  for (std::size_t i = 0; i < pdo.map().objects().size(); ++i) values[i] = dictionary_.raw(pdo.slot(i));
  Frame frame = pdo.map().pack(pdo.id(), values);
  if (other_map_) frame.size = static_cast<std::uint8_t>(frame.size / 2);
  answers.push(frame);
  pdo.told = servo_.statusword();
  pdo.never_told = false;
  pdo.told_ns = now_ns;
}

SimDevice make_sim_cia402(const SimPlace& place) {
  SimCia402Params params;
  params.id = place.device.id;
  params.servo.counts_per_rev = place.device.keys.cia402.counts_per_rev;
  params.servo.rated_torque_nm = place.device.keys.cia402.rated_torque_nm;
  params.servo.motor_torque_max_nm = cia402_torque_max_nm(place.device);
  params.joint = place.joint;
  params.plant = place.plant;
  params.errors = place.errors;
  auto node = std::make_unique<SimCia402>(params);
  CoupledDrive& drive = node->servo();
  return {std::move(node), &drive};
}

double cia402_torque_max_nm(const robot::DeviceConfig& device) { return 3 * device.keys.cia402.rated_torque_nm; }

}  // namespace lithe::hal::sim
