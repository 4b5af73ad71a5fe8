// SPDX-License-Identifier: Apache-2.0
// A guard between any law and simulated joints, without a bus: fast enough for thousands of runs.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <random>
#include <string>
#include <string_view>
#include <vector>

#include "spine/guard/guard.hpp"
#include "spine/hal/physics/chain.hpp"
#include "spine/hal/physics/plant.hpp"
#include "spine/hal/physics/truth.hpp"
#include "spine/robot/config.hpp"

namespace lithe::limits {

// What tries to break a joint out of its limits.
enum class Adversary : std::uint8_t {
  one_way,         // full torque to one side from the start
  late,            // follows a sine, then full torque
  pumps,           // pushes the way the joint moves
  back_and_forth,  // full torque to the far side, again and again
  random_torque,   // another one every tick
  random_hold,     // another one every so often
  chatters,        // full torque, the other way every tick
  wrong_sign,      // feedback that drives the error up
  switches_pd,     // the drive's own PD: gains and targets jump
  pd_at_limits,    // the drive's own PD at its stiffest, between targets at the limits
  fast_wall,       // coasts at its velocity limit and pushes at the last moment
  not_a_number,    // full torque, then none that is a number
};
inline constexpr int kAdversaries = 12;
std::string_view name_of(Adversary adversary);

struct Run {
  robot::RobotConfig robot;
  Adversary adversary = Adversary::one_way;
  std::uint64_t seed = 1;
  double seconds = 0.6;
  bool transport_thread = false;  // samples are one exchange old
  double stop_at_s = 1e9;         // a safe stop in the middle
  bool late_bus = false;          // now and then an exchange takes too long
  bool missed_answers = false;    // now and then a drive's answers are lost, eight in a row at most
  bool noise = false;             // each reading of an encoder is off by its plant's encoder_noise_rad
  bool recover = false;           // no law runs: the guard brings the joints inside
  bool never_dispatched = false;  // the guard is not told that its outputs were sent
  double model_error = 0;  // of a chain: masses, inertias and 0.4 of it centres differ from the file, up to this share
  double gain_error = 0;   // the drives' torque differs, up to this share
  double payload_kg = 0;   // at the tip of a chain, up to this
  std::vector<double> bias_nm;  // of each joint: what pulls at it beside the declared plant
  // Instead of the adversary, and a second look at the plant itself, for its errors.
  std::function<void(double time_s, const JointArray& position_rad, const JointArray& velocity_rad_s, Effort& out)> law;
  std::function<void(double time_s, const JointArray& position_rad)> watch;
  bool unguarded = false;                         // the law's output goes to the drives, within torque_max_nm
  std::vector<std::int64_t>* check_ns = nullptr;  // what each call of the guard took
};

struct Extremes {
  double overrun_rad = -1e9;   // beyond a position limit, the worst joint
  double speed_share = 0;      // of the velocity that is a fault
  double step_share = 0;       // change of torque when a command takes over, of the slew per command
  double promise_share = 0;    // the same where the guard expected the joint, of the slew per tick
  double opposite_rad = -1e9;  // beyond the limit that is farther from where the joint began, the worst joint
  double end_rad = -1e9;       // beyond a limit at the end, the worst joint
  wire::Fault fault = wire::Fault::none;  // the first that the guard told
  std::uint64_t ticks = 0;
  std::uint64_t changed = 0;  // ticks in which the guard did not give what the law wanted
};

// Plays one run. The plant of each joint is its `sim`; with a chain, all of them.
Extremes play(const Run& run);

}  // namespace lithe::limits
