// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/actuators.hpp"

#include <string>
#include <vector>

#include "spine/hal/bus/loop_bus.hpp"
#include "spine/hal/device/moteus.hpp"
#include "spine/hal/sim/sim_moteus.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

// Replies missed in a row until a joint counts as lost.
constexpr std::uint32_t kMissesToLose = 3;

struct Joint {
  MoteusDriver driver;
  std::size_t bus;
  std::uint32_t misses = 0;
};

JointCommand joint_command(const ActuatorCommand& command, std::size_t j) LITHE_RT {
  return {command.action,          command.torque_nm[j], command.position_rad[j], command.velocity_rad_s[j],
          command.kp_nm_rad[j], command.kd_nm_s_rad[j],  command.max_torque_nm[j]};
}

// Contract: see Actuators
class Robot final : public Actuators {
 public:
  explicit Robot(const robot::RobotConfig& config);

  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override;

 private:
  void collect(Bus& bus, std::size_t bus_index, ActuatorState& state) LITHE_RT;
  void count_silence(ActuatorState& state) LITHE_RT;

  std::vector<std::unique_ptr<LoopBus>> buses_;
  std::vector<std::unique_ptr<SimMoteus>> devices_;
  std::vector<Joint> joints_;
  ActuatorState last_;  // what every joint said last; the two buffers of the pipeline alternate
};

Robot::Robot(const robot::RobotConfig& config) {
  for (std::size_t i = 0; i < config.buses.size(); ++i) buses_.push_back(std::make_unique<LoopBus>());
  for (const robot::JointConfig& joint : config.joints) {
    const robot::DeviceConfig& device = config.devices[joint.device];
    MoteusSettings settings;
    settings.id = static_cast<std::uint8_t>(device.id);
    settings.watchdog_s = device.watchdog_s;
    settings.map = {joint.sign, joint.zero_rad, joint.ratio};
    devices_.push_back(std::make_unique<SimMoteus>(settings, joint.sim));
    buses_[device.bus]->attach(*devices_.back());
    joints_.push_back({MoteusDriver(settings), device.bus});
  }
  last_.joints = static_cast<std::uint32_t>(joints_.size());
}

void Robot::cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT {
  Frame frame;
  for (std::size_t j = 0; j < joints_.size(); ++j) {
    last_.status[j] &= ~wire::joint_status::kFresh;
    joints_[j].driver.encode(joint_command(command, j), frame);
    buses_[joints_[j].bus]->send(frame, now_ns);
  }
  last_.tick = command.tick;
  last_.sample_ns = now_ns;
  for (std::size_t b = 0; b < buses_.size(); ++b) collect(*buses_[b], b, last_);
  count_silence(last_);
  state = last_;
}

// Replies may come in any order, twice, or from nobody we know: each is offered to the joints of its bus.
void Robot::collect(Bus& bus, std::size_t bus_index, ActuatorState& state) LITHE_RT {
  Frame frame;
  for (std::size_t taken = 0; taken < 4 * kMaxJoints && bus.receive(frame); ++taken) {
    JointReading reading;
    for (std::size_t j = 0; j < joints_.size(); ++j) {
      if (joints_[j].bus != bus_index || !joints_[j].driver.decode(frame, reading)) continue;
      state.position_rad[j] = reading.position_rad;
      state.velocity_rad_s[j] = reading.velocity_rad_s;
      state.torque_nm[j] = reading.torque_nm;
      state.status[j] = reading.status;
      break;
    }
  }
}

void Robot::count_silence(ActuatorState& state) LITHE_RT {
  for (std::size_t j = 0; j < joints_.size(); ++j) {
    if ((state.status[j] & wire::joint_status::kFresh) != 0) {
      joints_[j].misses = 0;
      continue;
    }
    ++state.missed_replies;
    if (++joints_[j].misses >= kMissesToLose) state.status[j] |= wire::joint_status::kLost;
  }
}

}  // namespace

Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config) {
  if (config.joints.size() > kMaxJoints) {
    return Error{config.path + ": " + std::to_string(config.joints.size()) + " joints are more than this build's " +
                 std::to_string(kMaxJoints) + "; build with -DLITHE_NJ=64"};
  }
  return std::unique_ptr<Actuators>(std::make_unique<Robot>(config));
}

}  // namespace lithe::hal
