// SPDX-License-Identifier: Apache-2.0
// The motions from which the demo's agent estimates a joint, without a clock: for tests/system/agents/test_estimate.py.
//   probing_peer ROBOT.toml FIRST_NM SECOND_NM
// The first joint follows a sine under a weak PD for 6 s and is then probed with two constant torques for 4 s each, as
// brain/lithe/demo/agent.py does; every other joint is off. Commands leave a tick after they were computed. Standard
// output: little-endian doubles, per tick phase (0, 1, 2), time [s], angle [rad], velocity [rad/s], told torque [N m].
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <numbers>

#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"

namespace lithe {
namespace {

constexpr std::int64_t kStartNs = 1'000'000'000;
constexpr double kReadyS = 2.0, kSineS = 7.5, kRampS = 1.5, kProbeS = 4.0;
constexpr double kAmplitudeRad = std::numbers::pi / 4, kCentreRad = std::numbers::pi / 2, kHz = 0.5;

class Probing {
 public:
  Probing(const robot::RobotConfig& robot, hal::Actuators& actuators) : robot_(robot), actuators_(actuators) {
    command_.joints = static_cast<std::uint32_t>(robot.joints.size());
    command_.position_rad.fill(kNoTarget);
    for (std::size_t j = 0; j < robot.joints.size(); ++j) command_.max_torque_nm[j] = robot.joints[j].torque_max_nm;
  }

  void run(const std::array<double, 2>& torques_nm) {
    rest(hal::DriveAction::off);
    rest(hal::DriveAction::torque);
    for (double t_s = 0; t_s < kSineS; t_s += period_s()) cycle(t_s < kRampS ? -1 : 0, t_s, follow(t_s));
    for (int probe = 0; probe < 2; ++probe) {
      for (double t_s = 0; t_s < kProbeS; t_s += period_s()) {
        constexpr double kProbeRampS = 0.05;
        cycle(1 + probe, t_s, torques_nm.at(static_cast<std::size_t>(probe)) * std::min(1.0, t_s / kProbeRampS));
      }
    }
  }

 private:
  double period_s() const { return 1 / robot_.rate_hz; }

  void rest(hal::DriveAction action) {
    command_.action[0] = action;
    for (double t_s = 0; t_s < kReadyS; t_s += period_s()) cycle(-1, t_s, 0);
  }
  double follow(double t_s) const {
    const double most_nm = robot_.joints[0].torque_max_nm, faded = std::min(1.0, t_s / kRampS);
    const double wanted_rad = faded * (kCentreRad + kAmplitudeRad * std::sin(2 * std::numbers::pi * kHz * t_s));
    return most_nm / 12 * (wanted_rad - state_.position_rad[0]) - most_nm / 150 * state_.velocity_rad_s[0];
  }
  // `phase` below 0: nothing is written.
  void cycle(int phase, double t_s, double next_nm) {
    const double most_nm = robot_.joints[0].torque_max_nm;
    actuators_.cycle(command_, state_, now_ns_);
    now_ns_ += static_cast<std::int64_t>(1e9 * period_s());
    command_.torque_nm[0] = std::clamp(next_nm, -most_nm, most_nm);
    if (phase < 0) return;
    const std::array<double, 5> row{static_cast<double>(phase), t_s, state_.position_rad[0], state_.velocity_rad_s[0],
                                    state_.torque_nm[0]};
    std::fwrite(row.data(), sizeof(double), row.size(), stdout);
  }

  const robot::RobotConfig& robot_;
  hal::Actuators& actuators_;
  hal::ActuatorCommand command_;
  hal::ActuatorState state_;
  std::int64_t now_ns_ = kStartNs;
};

int main_(int argc, char** argv) {
  if (argc != 4) return 2;
  const auto robot = robot::load_robot(argv[1]);
  if (!robot) return std::fprintf(stderr, "%s\n", robot.message().c_str()), 1;
  auto actuators = hal::sim::simulate_actuators(*robot);
  if (!actuators) return std::fprintf(stderr, "%s\n", actuators.message().c_str()), 1;
  Probing(*robot, **actuators).run({std::atof(argv[2]), std::atof(argv[3])});
  return 0;
}

}  // namespace
}  // namespace lithe

int main(int argc, char** argv) { return lithe::main_(argc, argv); }
