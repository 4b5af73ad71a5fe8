// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/device/moteus_drive.hpp"

namespace lithe::hal::moteus {

bool MoteusDrive::command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT {
  Frame frame;
  const bool sound = driver_.encode(command, exchange.source, frame);
  bus.send(frame);  // a refusal shows as a missed answer, and is counted by the bus
  return sound;
}

Heard MoteusDrive::take(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT {
  if (!exchange.asked || source_of(frame) != exchange.source) return Heard::late;
  Answer answer;
  if (!driver_.decode(frame, answer)) return Heard::malformed;
  sample.position_rad = answer.position_rad;
  sample.velocity_rad_s = answer.velocity_rad_s;
  sample.torque_nm = answer.torque_nm;
  sample.status = status_of(answer);
  sample.measured = answer.measured;
  return Heard::answer;
}

}  // namespace lithe::hal::moteus
