// SPDX-License-Identifier: Apache-2.0
// The robot file: any text. What is refused is refused with a place; what is taken can be opened, run, and is in range.
#include <cmath>
#include <string>

#include "spine/core/joints.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

constexpr std::string_view kName = "fuzz.toml";

void check_refusal(const std::string& message) {
  require(!message.empty() && message.find('\0') == std::string::npos, "a refusal has words");
  require(message.starts_with(std::string(kName) + ":"), "a refusal names the place");
}

bool within(double value, double least, double most) { return value >= least && value <= most; }

void check_config(const robot::RobotConfig& robot) {
  require(!robot.name.empty() && robot.name.size() <= 31, "a robot has a name");
  require(within(robot.rate_hz, 100, 10'000), "a rate is one that can be kept");
  require(!robot.joints.empty() && robot.joints.size() <= kMaxJoints, "a robot has joints, and not too many");
  require(robot.sensors.size() <= robot::kMaxSensors, "no more sensors than the map holds");
  for (const robot::DeviceConfig& device : robot.devices) {
    require(device.bus < robot.buses.size(), "a device is on a bus that is there");
    const bool addressed = !robot::facts(device.kind).on_bus || within(device.id, 1, 126);
    require(addressed && device.rate_divider >= 1, "a device has an address, and is asked");
    for (const robot::DeviceConfig& other : robot.devices) {
      const bool apart = &other == &device || other.bus != device.bus || other.id != device.id;
      require(apart || !robot::facts(device.kind).on_bus, "no two devices of a bus have one address");
    }
    require(within(device.watchdog_s, 0.005, 10) && within(device.keys.cia402.counts_per_rev, 1, 1e9),
            "a device is in range");
  }
  for (const robot::JointConfig& joint : robot.joints) {
    require(joint.device < robot.devices.size(), "a joint has a device that is there");
    require(robot::is_drive(robot.devices[joint.device].kind), "a joint's device is a drive");
    require((joint.sign == 1 || joint.sign == -1) && within(joint.ratio, 1e-3, 1e4), "a joint turns one way");
    require(joint.position_min_rad < joint.position_max_rad, "a joint has room to move");
    require(within(joint.velocity_max_rad_s, 1e-9, 1e4) && within(joint.torque_max_nm, 1e-9, 1e6), "limits are limits");
    require(within(joint.torque_slew_nm_s, 1e-9, 1e9) && within(joint.kp_max_nm_rad, 0, 1e6), "limits are limits");
  }
  for (const robot::SensorConfig& sensor : robot.sensors) {
    require(sensor.device < robot.devices.size() && sensor.channel < 16, "a sensor is a channel of a device");
    const robot::DeviceConfig& device = robot.devices[sensor.device];
    require(!robot::is_drive(device.kind), "a sensor is a gateway's or a board's");
    require(sensor.channel < robot::inputs_of(device, sensor.kind), "a sensor's channel is one that its device has");
  }
}

// Simulated, whatever the file says: nothing real is opened.
void run_robot(const robot::RobotConfig& robot) {
  const auto actuators = hal::sim::simulate_actuators(robot);
  if (!actuators && robot.plant.kind == robot::PlantKind::mujoco) return check_refusal(actuators.message());
  require(bool(actuators), "a robot that is taken can be opened");
  hal::ActuatorCommand command;
  command.joints = static_cast<std::uint32_t>(robot.joints.size());
  hal::ActuatorState state;
  std::int64_t now_ns = 1'000'000'000;
  for (std::uint64_t tick = 1; tick <= 3; ++tick) {
    command.tick = tick;
    command.action.fill(tick == 2 ? hal::DriveAction::torque : hal::DriveAction::off);
    (*actuators)->cycle(command, state, now_ns += 1'000'000);
    for (std::size_t i = 0; i < robot.joints.size(); ++i) {
      require(std::isfinite(state.position_rad[i]) && std::isfinite(state.velocity_rad_s[i]) &&
                  std::isfinite(state.torque_nm[i]),
              "a simulated robot is somewhere");
    }
  }
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  const auto robot = robot::parse_robot(input.text(1 << 15), std::string(kName));
  if (!robot) return check_refusal(robot.message());
  check_config(*robot);
  if (robot->joints.size() <= 4) run_robot(*robot);
}

std::vector<Seed> seeds() {
  const std::string head =
      "name = \"arm\"\nrate_hz = 1000\nlaw = \"pd.cpp\"\n[spine]\nrelease = \"spin\"\ncpu_spine = 1\n[guard]\n"
      "safe_end = \"hold\"\nsoft_start_s = 0.5\n[brain]\nstale_after_s = 0.2\n[swap]\nblend_s = 0.01\n";
  const std::string bus = "[[bus]]\nname = \"can0\"\nkind = \"loop\"\n";
  const std::string drive = "[[device]]\nname = \"d\"\nkind = \"moteus\"\nbus = \"can0\"\nid = 1\nwatchdog_s = 0.1\n";
  const std::string joint =
      "[[joint]]\nname = \"j\"\ndevice = \"d\"\nsign = -1\nzero_rad = 0.1\nratio = 6.0\n"
      "position_min_rad = -2.5\nposition_max_rad = 2.5\nvelocity_max_rad_s = 15\ntorque_max_nm = 6.0\n"
      "torque_slew_nm_s = 1200\nsafe_kd_nm_s_rad = 0.5\n[joint.sim]\ninertia_kg_m2 = 1.5e-2\nmgl_nm = 0.8\n";
  const std::string cia402 =
      "[[device]]\nname = \"d\"\nkind = \"cia402\"\nbus = \"can0\"\nid = 2\nmode = \"position\"\n"
      "counts_per_rev = 4096\nrated_torque_nm = 1.27\n";
  const std::string gateway =
      "[[device]]\nname = \"g\"\nkind = \"gateway\"\nbus = \"can0\"\nid = 20\n[[sensor]]\nname = \"s\"\n"
      "device = \"g\"\nkind = \"analog\"\nchannel = 3\nscale = 0.01\noffset = 1\n";
  const std::string real =
      "[[bus]]\nname = \"can0\"\nkind = \"slcan\"\npath = \"/dev/null\"\nbitrate = 500_000\nreply_wait_s = 0.01\n";
  const std::string chain = "[plant]\nkind = \"chain\"\n";
  const std::string link = "length_m = 0.3\nmass_kg = 1.5\ncenter_m = 0.1\nlink_inertia_kg_m2 = 0.01\n";
  std::vector<Seed> all;
  for (const std::string& text :
       {head + bus + drive + joint, head + bus + drive + gateway + joint, head + bus + cia402 + joint,
        head + chain + bus + drive + joint + link,
        head + "[plant]\nkind = \"mujoco\"\nmodel = \"arm.xml\"\n" + bus + drive + joint, head + real + cia402 + joint,
        "[defaults.joint]\nratio = 1.0\nsafe_kd_nm_s_rad = 1\n" + head, head, std::string("name = \"\xff\""),
        head + bus + bus + drive + drive + joint + joint,
        std::string("x = [[[[[[{a={b=1}}]]]]]]\n[[bus]]\n[[bus.x]]\n"),
        head + bus + drive + "rate_divider = 0\n" + joint,
        head + bus + drive + joint +
            "[[joint]]\nname = \"k\"\ndevice = \"d\"\nposition_min_rad = 1\nposition_max_rad = 0\n",
        head + bus + drive + "[[joint]]\nposition_min_rad = 3\n" + joint.substr(10, joint.find("position_min") - 10) +
            joint.substr(joint.find("position_max")),
        head + bus + drive + joint + "ratio = nan\nposition_max_rad = inf\ntypo_rad = 1979-05-27\n"}) {
    all.push_back(Script().text(text));
  }
  return all;
}

}  // namespace lithe::fuzz
