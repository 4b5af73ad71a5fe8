// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia401/cia401_module.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "spine/hal/canopen/canopen_text.hpp"

namespace lithe::hal::cia401 {

using canopen::NmtState;
using canopen::SdoClient;
namespace common = canopen::object;

namespace {

constexpr std::uint32_t kByItsProfile = 255;  // transmission type: on a change, and when the event timer ends
constexpr std::uint8_t kEventTimerMs = 5;     // subindex of 1800h

}  // namespace

namespace {

std::string sentence(const NotReadyReason& not_ready) {
  const std::string object = fmt::format("object {:04X}h:{:02X}", not_ready.address.index, not_ready.address.subindex);
  switch (not_ready.kind) {
    case NotReadyKind::none:
      break;
    case NotReadyKind::not_booted:
      return "it was reset and does not report back: check power, wires and its id; it is reset again every 5 s";
    case NotReadyKind::no_answer:
      return "it does not answer when " + object + " is set: check its power and its id";
    case NotReadyKind::refused:
      return "it refuses " + object + ": " + std::string(canopen::abort_name(not_ready.value)) +
             "; has it as many inputs as the robot file says?";
    case NotReadyKind::no_module:
      return "its profile is " + std::to_string(not_ready.value & 0xffff) +
             ", not 401: name the right device, or its kind";
    case NotReadyKind::not_operational:
      return "it left its operational state by itself; it is set up again";
    case NotReadyKind::silent:
      return "its heartbeat has ended: check power and wires; it is reset every 5 s";
  }
  return "";
}

}  // namespace

std::string describe(const NotReadyReason& not_ready, const std::string& lacking) {
  return sentence(not_ready) + (lacking.empty() ? "" : "; it lacks " + lacking + ", too");
}

Setup::Setup(const ModuleParams& params) : client_(params.id) {
  add(common::kDeviceType, 0, 0, 0);
  add(common::kProducerHeartbeatMs, 0, canopen::milliseconds(params.heartbeat_s), 2);
  if (params.inputs.analog > 0) add(object::kAnalogInterrupt, 0, 1, 1, true);
  for (std::size_t number = 0; number < kPdos; ++number) add_pdo(number, params);
}

void Setup::add(std::uint16_t index, std::uint8_t subindex, std::uint32_t value, std::uint8_t bytes, bool may_lack) {
  steps_[count_++] = {{index, subindex}, value, bytes, may_lack};
}

void Setup::add_pdo(std::size_t number, const ModuleParams& params) {
  const auto communication = static_cast<std::uint16_t>(common::kTpdo1 + number);
  const auto mapping = static_cast<std::uint16_t>(common::kTpdo1Mapping + number);
  const std::uint32_t id = canopen::cob::kNoRemote | pdo_id(number, params.id);
  const canopen::PdoMap map = pdo_map(number, params.inputs);
  const bool used = !map.objects().empty();
  add(communication, 1, canopen::cob::kOff | id, 4, !used);
  if (!used) return;
  add(mapping, 0, 0, 1);
  std::uint8_t entry = 0;
  for (const canopen::Mapped& mapped : map.objects()) add(mapping, ++entry, mapped.entry(), 4);
  add(mapping, 0, entry, 1);
  add(communication, 2, kByItsProfile, 1);
  add(communication, kEventTimerMs, canopen::milliseconds(params.send_every_s), 2);
  add(communication, 1, id, 4);
}

void Setup::begin(bool look) LITHE_RT {
  at_ = 0;
  only_looks_ = look;
  lacks_ = 0;
  not_ready_ = {};
  client_.forget();
}

bool Setup::next(std::int64_t now_ns, Frame& frame) LITHE_RT {
  if (at_ >= count_) return false;
  const Step& step = steps_[at_];
  if (client_.outcome() == SdoClient::Outcome::idle) {
    if (step.bytes == 0 || only_looks_)
      client_.read(only_looks_ ? canopen::mapped_or_self(step.address, step.value) : step.address);
    else
      client_.write(step.address, step.value, step.bytes);
  }
  return client_.next(now_ns, frame);
}

Setup::Progress Setup::advance() LITHE_RT {
  const auto end = [this]()
                       LITHE_RT { return not_ready_.kind == NotReadyKind::none ? Progress::done : Progress::failed; };
  if (at_ >= count_) return end();
  const Step& step = steps_[at_];
  const SdoClient::Outcome outcome = client_.outcome();
  if (outcome == SdoClient::Outcome::idle || outcome == SdoClient::Outcome::busy) return Progress::busy;
  const std::uint32_t why = outcome == SdoClient::Outcome::failed ? client_.abort() : canopen::abort_code::kNone;
  if (why != canopen::abort_code::kNone)
    bear(step, why);
  else if (step.bytes == 0 && (client_.value() & 0xffff) != kDeviceProfile)
    refuse(NotReadyKind::no_module, step, client_.value());
  client_.forget();
  if (why == canopen::abort_code::kTimedOut) return Progress::failed;
  only_looks_ = only_looks_ || not_ready_.kind != NotReadyKind::none;
  return ++at_ >= count_ ? end() : Progress::busy;
}

void Setup::bear(const Step& step, std::uint32_t why) LITHE_RT {
  if (why == canopen::abort_code::kTimedOut) return refuse(NotReadyKind::no_answer, step, why);
  const bool lacks = why == canopen::abort_code::kNoObject || why == canopen::abort_code::kNoSubindex;
  if (lacks && step.may_lack) return;
  if (only_looks_ && !lacks) return;  // it is there, though it cannot be read
  if (only_looks_) lacks_ |= std::uint64_t{1} << at_;
  refuse(NotReadyKind::refused, step, why);
}

// The first reason stays.
void Setup::refuse(NotReadyKind kind, const Step& step, std::uint32_t value) LITHE_RT {
  const canopen::Address at = only_looks_ ? canopen::mapped_or_self(step.address, step.value) : step.address;
  if (not_ready_.kind == NotReadyKind::none) not_ready_ = {kind, at, value};
}

std::string Setup::lacking(std::uint64_t lacks, std::uint16_t but_for) const {
  canopen::ObjectList list(but_for);
  for (std::size_t i = 0; i < count_; ++i)
    if ((lacks >> i & 1U) != 0) list.add(canopen::mapped_or_self(steps_[i].address, steps_[i].value));
  return list.text();
}

Module::Module(const ModuleParams& params) : params_(params), setup_(params) {
  params_.inputs.digital = std::min<std::uint32_t>(params.inputs.digital, kDigital);
  params_.inputs.analog = std::min<std::uint32_t>(params.inputs.analog, kAnalog);
  for (std::size_t i = 0; i < kPdos; ++i) maps_[i] = pdo_map(i, params_.inputs);
  watch_anew();
}

std::string Module::why_not_ready() const {
  const NotReadyReason why = NotReadyReason::unpacked(not_ready_.load(std::memory_order_relaxed));
  return describe(why, setup_.lacking(lacks_.load(std::memory_order_relaxed), why.address.index));
}

// From its next heartbeat on.
void Module::watch_anew() LITHE_RT {
  heartbeat_.set_timeout(static_cast<std::int64_t>(1e9 * kHeartbeatsToSilence * params_.heartbeat_s));
}

void Module::step(const Exchange& exchange, Bus& bus) LITHE_RT {
  const std::int64_t now_ns = exchange.now_ns;
  if (heartbeat_.lost(now_ns) && stage_ != Stage::await_boot_up) {
    tell({NotReadyKind::silent, {}, 0});
    valid_.fill(false);
    stage_ = Stage::reset;
  }
  if (stage_ == Stage::setup) judge_setup(now_ns);
  const bool waited = now_ns - since_ns_ >= kBootNs;
  if (stage_ == Stage::await_boot_up && waited) {
    tell({NotReadyKind::not_booted, {}, 0});
    stage_ = Stage::reset;
  }
  if (stage_ == Stage::refused && waited) stage_ = Stage::reset;
  Frame frame;
  if (stage_ == Stage::reset) {
    if (!bus.send(canopen::nmt_frame(canopen::NmtCommand::reset_node, params_.id))) return;
    stage_ = Stage::await_boot_up;
    since_ns_ = now_ns;
  } else if (stage_ == Stage::setup) {
    if (setup_.next(now_ns, frame)) bus.send(frame);  // what is refused is sent again when it has timed out
  } else if (stage_ == Stage::start) {
    if (bus.send(canopen::nmt_frame(canopen::NmtCommand::start, params_.id))) stage_ = Stage::running;
    since_ns_ = now_ns;
  }
}

void Module::judge_setup(std::int64_t now_ns) LITHE_RT {
  const Setup::Progress progress = setup_.advance();
  if (progress == Setup::Progress::done) stage_ = Stage::start;
  if (progress != Setup::Progress::failed) return;
  tell(setup_.not_ready(), setup_.lacks());
  stage_ = Stage::refused;
  since_ns_ = now_ns;
}

void Module::set_up_anew() LITHE_RT {
  valid_.fill(false);
  watch_anew();
  setup_.begin();
  stage_ = Stage::setup;
}

void Module::on_frame(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  const std::uint32_t function = canopen::function_of(frame);
  if (function == canopen::cob::kHeartbeat) return on_heartbeat(frame, now_ns);
  if (function == canopen::cob::kSdoAnswer) {
    if (stage_ == Stage::setup && setup_.on_frame(frame)) judge_setup(now_ns);
    return;
  }
  for (std::size_t i = 0; i < kPdos; ++i)
    if (frame.id == pdo_id(i, params_.id)) return on_inputs(i, frame, now_ns);
  canopen::Emergency what;  // ignored: the age of the inputs shows the fault
  if (function != canopen::cob::kEmergency || !canopen::parse_emergency(frame, what)) ++malformed_;
}

void Module::on_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  NmtState state{};
  if (!canopen::parse_heartbeat(frame, state)) {
    ++malformed_;
    return;
  }
  if (state == NmtState::boot_up) return set_up_anew();  // it has lost its configuration
  heartbeat_.received(now_ns);
  if (stage_ == Stage::await_boot_up && now_ns - since_ns_ >= kResetNs) stage_ = Stage::reset;
  if (stage_ != Stage::running) return;
  if (state == NmtState::operational) return tell({});
  if (now_ns - since_ns_ < kResetNs) return;  // it may have sent this before it was started
  tell({NotReadyKind::not_operational, {}, static_cast<std::uint8_t>(state)});
  valid_.fill(false);
  if (state == NmtState::stopped)  // it answers no SDO
    stage_ = Stage::reset;
  else
    set_up_anew();
}

void Module::on_inputs(std::size_t number, const Frame& frame, std::int64_t now_ns) LITHE_RT {
  if (stage_ != Stage::running) return;  // by another mapping
  std::array<std::uint32_t, canopen::PdoMap::kMost> raw{};
  const canopen::PdoMap& map = maps_[number];
  if (frame.size != map.bytes() || !map.unpack(frame, raw)) {
    ++malformed_;
    return;
  }
  for (std::size_t i = 0; i < map.objects().size(); ++i) {
    const std::size_t at = map.objects()[i].address.subindex - 1U;
    if (number == 0)
      digital_[at] = static_cast<std::uint8_t>(raw[i]);
    else
      analog_[at] = static_cast<std::int16_t>(raw[i]);
  }
  taken_ns_[number] = now_ns;
  valid_[number] = true;
}

bool Module::read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT {
  const bool digital = block == Block::digital;
  if (block == Block::imu || channel >= (digital ? params_.inputs.digital : params_.inputs.analog)) return false;
  const std::size_t number = digital ? 0 : 1 + channel / kAnalogPerPdo;
  if (!valid_[number] || now_ns - taken_ns_[number] > params_.stale_ns) return false;
  raw = digital ? digital_[channel / 8] >> channel % 8 & 1 : analog_[channel];
  return true;
}

namespace {

ModuleParams params_of(const robot::DeviceConfig& device) {
  ModuleParams params;
  params.id = device.id;
  params.inputs = device.keys.cia401.inputs;
  params.send_every_s = device.keys.cia401.send_every_s;
  params.stale_ns = std::llround(1e9 * device.watchdog_s);
  return params;
}

}  // namespace

std::unique_ptr<SensorDevice> make_module(const robot::DeviceConfig& device) {
  return std::make_unique<Module>(params_of(device));
}

std::string look(const robot::RobotConfig& /*robot*/, const robot::DeviceConfig& device, const AskedBus& line) {
  Setup setup(params_of(device));
  setup.begin(true);
  canopen::converse(
      line, device.id, [&](std::int64_t now_ns, Frame& frame) { return setup.next(now_ns, frame); },
      [&](const Frame& frame) { return setup.on_frame(frame); },
      [&] { return setup.advance() != Setup::Progress::busy; });
  return describe(setup.not_ready(), setup.lacking(setup.lacks(), setup.not_ready().address.index));
}

PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& /*bus*/) {
  PlannedFrames frames;
  for (std::size_t number = 0; number < kPdos; ++number) {
    const std::size_t bytes = pdo_map(number, device.keys.cia401.inputs).bytes();
    if (bytes == 0) continue;
    frames.push_back({.what = number == 0 ? "digital" : "analog",
                      .size = bytes,
                      .id = pdo_id(number, device.id),
                      .per_s = 1 / device.keys.cia401.send_every_s,
                      .unasked = true});
  }
  frames.push_back({.what = "heartbeat",
                    .size = 1,
                    .id = canopen::cob::kHeartbeat + device.id,
                    .per_s = 1 / ModuleParams{}.heartbeat_s});
  return frames;
}

bool process_map(const robot::DeviceConfig& device, std::uint32_t id, canopen::PdoMap& map) {
  for (std::size_t number = 0; number < kPdos; ++number) {
    if (id != pdo_id(number, device.id)) continue;
    map = pdo_map(number, device.keys.cia401.inputs);
    return !map.objects().empty();
  }
  return false;
}

// For example "digital 0-7 00000101", with input 0 last; "analog 3 -120".
std::string process_value(const canopen::Mapped& mapped, std::uint32_t raw) {
  const std::uint32_t first = mapped.address.subindex - 1U;
  if (mapped.address.index == object::kAnalogInputs)
    return fmt::format("analog {} {}", first, canopen::signed_of(raw, mapped.bytes));
  return fmt::format("digital {}-{} {:08b}", 8 * first, 8 * first + 7, raw & 0xff);
}

std::string_view object_name(std::uint16_t index) {
  static constexpr canopen::Names kObjects[] = {{object::kDigitalInputs, "digital inputs"},
                                                {object::kAnalogInputs, "analog inputs"},
                                                {object::kAnalogInterrupt, "analog inputs are sent"}};
  return canopen::name_in(kObjects, index);
}

}  // namespace lithe::hal::cia401
