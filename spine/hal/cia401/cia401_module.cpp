// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia401/cia401_module.hpp"

#include <algorithm>

namespace lithe::hal::cia401 {

using canopen::NmtState;

Module::Module(const ModuleParams& params) : params_(params), setup_(params) {
  params_.inputs.digital = std::min<std::uint32_t>(params.inputs.digital, kDigital);
  params_.inputs.analog = std::min<std::uint32_t>(params.inputs.analog, kAnalog);
  for (std::size_t i = 0; i < kPdos; ++i) maps_[i] = pdo_map(i, params_.inputs);
  watch_anew();
}

// From its next heartbeat on.
void Module::watch_anew() LITHE_RT {
  heartbeat_.set_timeout(static_cast<std::int64_t>(1e9 * kBeatsToSilence * params_.heartbeat_s));
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
  switch (stage_) {
    case Stage::reset:
      if (!bus.send(canopen::nmt_frame(canopen::NmtCommand::reset_node, params_.id))) return;
      stage_ = Stage::await_boot_up;
      since_ns_ = now_ns;
      break;
    case Stage::setup:
      if (setup_.next(now_ns, frame)) bus.send(frame);  // what is refused is sent again when it has timed out
      break;
    case Stage::start:
      if (bus.send(canopen::nmt_frame(canopen::NmtCommand::start, params_.id))) stage_ = Stage::running;
      since_ns_ = now_ns;
      break;
    case Stage::await_boot_up:
    case Stage::running:
    case Stage::refused:
      break;
  }
}

void Module::judge_setup(std::int64_t now_ns) LITHE_RT {
  const Setup::Progress progress = setup_.advance();
  if (progress == Setup::Progress::done) stage_ = Stage::start;
  if (progress != Setup::Progress::failed) return;
  tell(setup_.not_ready());
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
  canopen::Emergency what;  // of which nothing follows: its inputs tell how old they are
  if (function != canopen::cob::kEmergency || !canopen::parse_emergency(frame, what)) ++malformed_;
}

void Module::on_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  NmtState state{};
  if (!canopen::parse_heartbeat(frame, state)) {
    ++malformed_;
    return;
  }
  if (state == NmtState::boot_up) return set_up_anew();  // it has lost its configuration
  heartbeat_.beat(now_ns);
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

}  // namespace lithe::hal::cia401
