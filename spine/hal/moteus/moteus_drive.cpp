// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_drive.hpp"

#include <algorithm>
#include <cmath>

#include "spine/wire/wire.hpp"

namespace lithe::hal::moteus {

MoteusDrive::MoteusDrive(const DriverParams& params)
    : driver_(params),
      asks_(params.ask_settings),
      setup_(expected_of(params)),
      torque_step_nm_(params.torque_step_nm),
      torque_allowed_nm_(params.torque_step_nm) {
  tell();
}

bool MoteusDrive::command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT {
  if (unanswered_ == kForgets) forgotten_ = true;
  if (unanswered_ <= kForgets) ++unanswered_;
  if (forgotten_ && command.action == DriveAction::off) {
    setup_.restart();
    forgotten_ = false;
    tell();
  }
  Frame frame;
  bool sound = true;
  if (ready()) {
    JointCommand eased = command;
    // Non-finite values are kept, so that the driver detects them.
    if (std::isfinite(command.max_torque_nm)) eased.max_torque_nm = std::min(command.max_torque_nm, torque_allowed_nm_);
    sound = driver_.encode(eased, exchange.source, frame, velocity_rad_s_);
    asked_ = false;
  } else {
    if (asked_) setup_.missed();
    driver_.encode_setup(setup_, exchange.source, frame);
    asked_ = true;
  }
  bus.send(frame);  // a refusal is counted by the bus, and the answer is missed
  return sound;
}

ReplyKind MoteusDrive::take(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT {
  if (!exchange.asked || source_of(frame) != exchange.source) return ReplyKind::late;
  if (!driver_.decode(frame, sample)) return ReplyKind::malformed;
  unanswered_ = 0;
  if (asked_) {
    asked_ = false;  // a duplicate frame is used once
    setup_.take(frame);
    if (setup_.ready()) driver_.know(setup_.settings());
    tell();
  }
  const bool drives = mode_of(sample.status) == Mode::position;
  torque_allowed_nm_ = drives ? torque_allowed_nm_ + torque_step_nm_ : torque_step_nm_;
  if (sample.measured) velocity_rad_s_ = sample.velocity_rad_s;
  if (!ready()) sample.status |= wire::joint_status::kNotReady;
  return ReplyKind::answer;
}

}  // namespace lithe::hal::moteus
