// SPDX-License-Identifier: Apache-2.0
// Why a law is replaced or the robot stopped, as the text of an event: joint, value and limit.
#include <algorithm>
#include <cmath>

#include "spine/step/laws.hpp"

namespace lithe::step {

using wire::LawFaultKind;
namespace flag = wire::telemetry_flag;

void tell_beyond(const robot::RobotConfig& robot, const Tick& in, std::size_t joint, wire::Fault fault,
                 EventText& words) LITHE_RT {
  const robot::JointConfig& config = robot.joints[joint];
  const double overrun_rad = robot.guard.position_overrun_rad;
  if (fault == wire::Fault::position_limit) {
    (words << ": ").number(in.position_rad[joint], 3) << " rad, allowed ";
    words.number(config.position_min_rad - overrun_rad, 3) << " to ";
    words.number(config.position_max_rad + overrun_rad, 3);
  } else if (fault == wire::Fault::velocity_limit) {
    (words << ": ").number(in.velocity_rad_s[joint], 1) << " rad/s, allowed ";
    words.number(config.velocity_max_rad_s * robot.guard.velocity_overrun, 1);
  }
}

// What the law saw of a joint, or a sensor that was not valid.
void Laws::tell_inputs(std::size_t joint, EventText& words) const LITHE_RT {
  for (std::size_t i = 0; i < robot_.sensors.size() && i < in_.sensor.size(); ++i) {
    if (std::isnan(in_.sensor[i])) {
      words << "sensor " << robot_.sensors[i].name << " was NaN";
      return;
    }
  }
  (words << "at ").number(in_.position_rad[joint], 3) << " rad, ";
  words.number(in_.velocity_rad_s[joint], 2) << " rad/s, ";
  words.number(in_.torque_nm[joint], 2) << " N m, setpoint ";
  words.number(in_.setpoint_position_rad[joint], 3);
}

// "overran: ended after 812.0 us, allowed 800.0"; "not_finite: joint elbow, torque_nm; at 0.100 rad, 3.20 rad/s, 0.15
// N m, setpoint 0.250".
EventText Laws::in_words(const Run& failed) const LITHE_RT {
  EventText words;
  words << wire::to_string(failed.failure.kind);
  if (failed.failure.kind == LawFaultKind::overran) {
    (words << ": ended after ").number(1e-3 * static_cast<double>(failed.took_ns), 1) << " us, allowed ";
    words.number(1e-3 * static_cast<double>(failed.budget_ns), 1);
  } else if (failed.joint < robot_.joints.size()) {
    words << ": joint " << robot_.joints[failed.joint].name << ", " << failed.output << "; ";
    tell_inputs(failed.joint, words);
  }
  return words;
}

// What the guard clamps now, with the value and its limit: "wants 12.000 N m of 0.600".
void Laws::tell_clamped(const Probation::Evidence& evidence, EventText& words) const LITHE_RT {
  const robot::JointConfig& joint = robot_.joints[evidence.joint];
  const double torque_nm = wanted_nm(effort_, in_, evidence.joint), speed_rad_s = in_.velocity_rad_s[evidence.joint];
  // The guard brakes ahead of both limits, with one flag: at half the speed limit the speed is the more telling one.
  const bool fast = std::abs(speed_rad_s) > 0.5 * joint.velocity_max_rad_s;
  if (evidence.clamped == Probation::kSlewed) {
    (words << "torque_slew_nm_s is ").number(joint.torque_slew_nm_s, 0);
  } else if ((evidence.clamped & flag::kTorqueClamped) != 0) {
    (words << "wants ").number(torque_nm, 3) << " N m of ";
    words.number(joint.torque_max_nm, 3);
  } else if ((evidence.clamped & flag::kVelocityClamped) != 0 || fast) {
    (words << "at ").number(speed_rad_s, 1) << " rad/s of ";
    words.number(joint.velocity_max_rad_s, 1);
  } else {
    (words << "at ").number(in_.position_rad[evidence.joint], 3) << " rad of ";
    words.number(torque_nm > 0 ? joint.position_max_rad : joint.position_min_rad, 3);
  }
}

// "oscillating: joint wrist, 31 Hz, swings of 20.00, allowed 1.50 rad/s"; "tracking_lost: joint elbow, error 0.312 rad,
// allowed 0.150"; "pushes_away: joint elbow, error 0.312 rad, allowed 0.150: wants -6.000 N m"; "guard_busy: joint
// elbow clamped in 80.1 % of ticks, allowed 80: wants 12.000 N m of 0.600".
EventText Laws::in_words(const Probation::News& news) const LITHE_RT {
  const Probation::Evidence& evidence = news.evidence;
  EventText words;
  words << wire::to_string(news.kind);
  switch (news.kind) {
    case LawFaultKind::chattering:
    case LawFaultKind::oscillating:
      words << ": joint " << robot_.joints[evidence.tremor.joint].name << ", ";
      words.number(evidence.tremor.frequency_hz, 0) << " Hz, swings of ";
      words.number(evidence.tremor.size, 2) << ", allowed ";
      words.number(evidence.tremor.least_size, 2) << (news.kind == LawFaultKind::chattering ? " N m" : " rad/s");
      break;
    case LawFaultKind::tracking_lost:
    case LawFaultKind::pushes_away:
    case LawFaultKind::gives_no_torque:
      words << ": joint " << robot_.joints[evidence.joint].name << ", error ";
      words.number(evidence.value, 3) << " rad, allowed ";
      words.number(evidence.allowed, 3);
      if (news.kind != LawFaultKind::tracking_lost)
        (words << ": wants ").number(wanted_nm(effort_, in_, evidence.joint), 3) << " N m";
      break;
    case LawFaultKind::guard_busy:
      words << ": joint " << robot_.joints[evidence.joint].name
            << (evidence.clamped == Probation::kSlewed ? " slewed in " : " clamped in ");
      words.number(100 * evidence.value, 1) << " % of ticks, allowed ";
      words.number(100 * evidence.allowed, 0) << ": ";
      tell_clamped(evidence, words);
      break;
    case LawFaultKind::guard_stopped:
      words << ": joint " << robot_.joints[evidence.joint].name << ", "
            << wire::to_string(guard_.joint_fault(evidence.joint));
      tell_beyond(robot_, in_, evidence.joint, guard_.joint_fault(evidence.joint), words);
      break;
    case LawFaultKind::overran:
      (words << ": a step took ").number(1e6 * evidence.value, 1) << " us, allowed ";
      (words.number(1e6 * evidence.allowed, 1) << ", ").number(Probation::kMostLong, 0) << " times in a row";
      break;
    default:
      break;
  }
  return words;
}

}  // namespace lithe::step
