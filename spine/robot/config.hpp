// SPDX-License-Identifier: Apache-2.0
// A robot as robot.toml describes it: plain structs, every value checked, every reference already an index.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "spine/mechanics/tree.hpp"
#include "spine/robot/kinds.hpp"

namespace lithe::robot {

// "auto": the program chooses the core (docs/rt.md).
inline constexpr int kAutoCpu = -1;
// A number that the file does not give.
inline constexpr double kUnsaid = std::numeric_limits<double>::quiet_NaN();

enum class Release { spin, hybrid, sleep };                // how the Spine waits for the next release
enum class TransportPlace { automatic, thread, inlined };  // where the buses are served
enum class LawLoader { arena, dlopen };                    // where the code of laws lives in the Spine
enum class MissPolicy { skip, stop };                      // what a missed deadline, or a torn plan, does
enum class StaleAction { hold, safe_stop };                // what a silent Brain does
enum class SafeEnd { damp, hold };                         // how the safe law ends, once the joint has slowed down
enum class OtherGroups { stop, go_on };                    // what a joint's fault does to the groups it is not in
enum class WatchAction { alarm, stop, last_good };         // what follows when a confirmed law turns bad
enum class PlantKind { independent, chain, mujoco };       // coupling of simulated joints

inline constexpr std::size_t kMaxSensors = 16;  // the size of Tick::sensor
inline constexpr std::size_t kMaxInputs = 16;   // the size of Tick::input

struct SpineConfig {
  Release release = Release::spin;
  TransportPlace transport = TransportPlace::automatic;
  int cpu_spine = kAutoCpu;
  int cpu_transport = kAutoCpu;
  int cpu_brain = kAutoCpu;
  int cpu_housekeeping = kAutoCpu;
  LawLoader loader = LawLoader::arena;
  std::uint32_t late_ticks_to_stop = 20;
  MissPolicy miss_policy = MissPolicy::skip;
  std::int64_t phase_ns = 500'000;  // of the release grid against whole milliseconds of CLOCK_MONOTONIC
};

struct GuardConfig {
  SafeEnd safe_end = SafeEnd::damp;
  double soft_stop_rad = 0.1;           // width of the zone before a position limit in which outward torque fades
  double position_overrun_rad = 0.2;    // this far beyond a position limit is a fault
  double velocity_overrun = 1.25;       // this multiple of a joint's velocity limit is a fault
  std::uint32_t lost_after_misses = 3;  // missed answers in a row until the drive counts as lost (a fault)
  OtherGroups other_groups = OtherGroups::stop;
  // After arming the torque limits grow from 0 to their values during this time. The default is twice a person's
  // reaction time, so the e-stop can be pressed before a wrong law has full torque.
  double soft_start_s = 0.5;
  double recover_torque_share = 0.5;    // of torque_max_nm: the most that recover uses
  double recover_velocity_rad_s = 0.3;  // the speed at which recover brings a joint inside its limits
  // The ladder after the safe law: when a group's joints have been at rest for this long, their drives brake, and then
  // switch off. 0 = never.
  double brake_after_s = 0.0;
  double off_after_s = 0.0;
};

struct BrainConfig {
  double stale_after_s = 0.25;
  StaleAction on_stale = StaleAction::hold;
  MissPolicy on_torn_plan = MissPolicy::skip;  // torn: four reads gave no complete plan
};

// Default terms of a swap. A request may override them.
struct SwapConfig {
  double budget_share = 0.3;           // share of a tick that a law may take; beyond it the law before takes over
  double blend_s = 0.02;               // from the old law's torque to the new one's
  double probation_s = 1.0;            // during this time a law that does worse than the one before is replaced
  double probation_error_ratio = 3.0;  // worse: an error this many times the largest before; 0 = not judged
  WatchAction watch = WatchAction::last_good;
  double compile_s = 20.0;  // then the compiler of a law is stopped; the other limits of lawd follow it
};

struct BusConfig {
  std::string name;
  BusKind kind = BusKind::loop;
  std::string path;                        // of the serial device behind an adapter
  std::string interface;                   // of the kernel, as `ip link` names it
  std::uint32_t connector = 1;             // of a board, from 1
  std::uint32_t bitrate = 1'000'000;       // of the arbitration phase
  std::uint32_t data_bitrate = 5'000'000;  // of CAN FD's data phase; 0 = classic CAN only
  std::uint32_t baud = 0;                  // of the UART behind `path`, if it is one; 0 = the usual 921600
  double reply_wait_s = 0.002;             // time to wait for answers after the commands; a loop never waits
  BusKeys keys{};                          // that only one kind has
};

// True for an adapter behind a serial device.
constexpr bool is_serial(const BusConfig& bus) { return facts(bus.kind).place == PlaceKey::path; }

// True for hardware; false for a bus in memory with simulated devices.
constexpr bool is_real(const BusConfig& bus) { return facts(bus.kind).real; }

// True for CAN FD: frames of up to 64 bytes and a faster data phase.
constexpr bool is_fd(const BusConfig& bus) { return bus.data_bitrate > 0; }

// True for a bus on which classic frames can be sent, beside those of CAN FD or alone.
constexpr bool carries_classic(const BusConfig& bus) { return !is_fd(bus) || facts(bus.kind).no_classic.empty(); }

struct DeviceConfig {
  std::string name;
  DeviceKind kind = DeviceKind::moteus;
  std::size_t bus = 0;             // index into RobotConfig::buses
  std::uint32_t id = 1;            // 0 of an imu, which is of the board and on none of its buses
  double watchdog_s = 0.1;         // the device stops by itself after this time without a command
  std::uint32_t rate_divider = 1;  // asked once in this many ticks
  DeviceKeys keys{};               // that only one kind has
};

// Number of its channels of this kind.
constexpr std::size_t inputs_of(const DeviceConfig& device, SensorKind kind) {
  const DeviceFacts& is = facts(device.kind);
  return (is.inputs_in_use != nullptr ? is.inputs_in_use(device.keys) : is.inputs)[static_cast<std::size_t>(kind)];
}

// True for a drive that controls position or velocity itself.
constexpr bool closes_loop(const DeviceConfig& device) {
  const auto closes = facts(device.kind).closes_loop;
  return closes != nullptr && closes(device.keys);
}

// One channel of a device that measures: value = scale * raw + offset.
struct SensorConfig {
  std::string name;
  std::size_t device = 0;  // index into RobotConfig::devices
  SensorKind kind = SensorKind::analog;
  std::uint32_t channel = 0;
  double scale = 1.0;
  double offset = 0.0;
};

// A number that the Brain sends to the law beside the plan: a wanted velocity, a phase, a target. It is never tried.
struct InputConfig {
  std::string name;
  double min = 0, max = 0;
  double value = 0;  // until the Brain sends one
};

// [plant]: how the simulated joints are coupled.
struct MechanismConfig {
  PlantKind kind = PlantKind::independent;  // each on its own; links in a row; whatever a model says
  double gravity_m_s2 = 9.81;               // chain
  std::string model;                        // mujoco: absolute path of an MJCF file
  double step_s = 5e-5;                     // mujoco: of its physics; a multiple of 50 us
  bool ideal = false;                       // without errors of drives, cogging, Stribeck friction, payload
};

// The simulated plant at the far end of a joint's drive, in joint coordinates: angle 0 hangs straight down, gravity
// pulls with -mgl_nm * sin(angle). In a chain angles are those between links, and links are joined in the order of the
// robot's joints; the dynamics follow from the five numbers of each link.
struct PlantConfig {
  double inertia_kg_m2 = 2.5e-3;     // independent
  double mgl_nm = 0.0;               // independent
  double length_m = 0.0;             // chain: from its joint to the next one
  double mass_kg = 0.0;              // chain
  double center_m = 0.0;             // chain: from its joint to its centre of mass
  double link_inertia_kg_m2 = 0.0;   // chain: about its centre of mass
  double rotor_inertia_kg_m2 = 0.0;  // chain: of the motor, behind its gear
  double viscous_nm_s_rad = 0.0;
  double coulomb_nm = 0.0;
  double cogging_nm = 0.0;  // amplitude
  std::uint32_t cogging_per_rev = 84;
  double stribeck_nm = 0.0;     // dry friction at rest, above coulomb_nm
  double stribeck_rad_s = 0.1;  // at this speed 1/e of it is left
  double payload_kg = 0.0;      // maximum; the seed draws the value
  double payload_m = 0.0;       // from the joint
  double torque_lag_s = 1.0e-3;
  // Errors that the drive does not know. For the first two the seed draws a value between minus and plus this.
  double torque_gain_error = 0.0;        // the joint gets this share more torque than the drive reports
  double encoder_offset_rad = 0.0;       // reported angle minus the joint's angle
  double torque_noise_nm = 0.0;          // standard deviation of the reported torque
  double encoder_noise_rad = 0.0;        // standard deviation of an angle it reads, at the joint
  double bus_delay_s = 0.0;              // from the exchange in which a command leaves to its effect
  std::uint32_t encoder_counts = 16384;  // per revolution of the motor
  double initial_position_rad = 0.0;
  std::uint64_t seed = 1;
};

// [joint.model]: the joint's link and its drive as the guard knows them.
struct JointModel {
  bool given = false;
  mechanics::Link link;
  double coulomb_nm = 0;                  // dry friction of the hinge
  double torque_lag_s = 1e-3;             // of the motor, first order
  double velocity_filter_rad_s = 1256.6;  // bandwidth of the filter behind the drive's measured speed
  // Settled when the file is read (limits/model.hpp).
  double allotted_rad_s2 = 0;  // deceleration that all joints can have at once
  double kp_most_nm_rad = 0, kd_most_nm_s_rad = 0;
};

// [model]: with it the guard keeps the limits of all joints together; without it, of each joint alone.
struct ModelConfig {
  bool given = false;
  mechanics::Vector gravity_m_s2{0, 0, -9.81};  // in the base's frame
  double error = 0.4;                           // share by which an acceleration that it gives may be wrong
};

// Coordinates: position_rad = sign * device_rad / ratio + zero_rad; torque_nm = sign * ratio * device_nm.
struct JointConfig {
  std::string name;
  std::string group;       // joints that stop together; empty = with all others that name none
  std::size_t device = 0;  // index into RobotConfig::devices; one device drives one joint
  double sign = 1.0;       // +1 or -1
  double zero_rad = 0.0;   // the joint's angle where its device reads 0
  double ratio = 1.0;      // motor turns per joint turn
  double position_min_rad = 0.0;
  double position_max_rad = 0.0;
  double velocity_max_rad_s = 0.0;
  double torque_max_nm = 0.0;
  double torque_slew_nm_s = 0.0;
  double power_max_w = 0.0;    // mechanical, into the joint; 0 = no limit
  bool must_be_homed = false;  // no arming until the drive knows the joint's turn
  double deceleration_rad_s2 = 20.0;
  bool monotone = false;         // never overshoot a waypoint (grippers); costs smoothness
  double kp_max_nm_rad = 100.0;  // limit for the gain of the drive's own PD
  double kd_max_nm_s_rad = 5.0;
  double safe_kp_nm_rad = 0.0;  // PD of the safe law; every safe stop ends with its damping
  double safe_kd_nm_s_rad = 0.0;
  // The guard's model for stopping the joint inside its limits. Inertia 0: the guard does not brake ahead; a file
  // cannot set 0.
  double load_max_nm = 0.0;        // largest load in either direction: gravity, payload, other joints
  double inertia_max_kg_m2 = 0.0;  // of everything that turns with the joint, including the rotor behind its gear
  double inertia_min_kg_m2 = 0.0;
  bool inertia_declared = false;  // by the file; else both are taken from its simulation, or assumed
  double drive_lag_s = 0.003;     // command to torque, plus motion to measured speed
  JointModel model;
  PlantConfig sim;
};

// Contract: a value; built by load_robot and never changed afterwards · never in the tick
struct RobotConfig {
  std::string name;
  std::string path;  // of the file it came from
  double rate_hz = 1000.0;
  std::string law;  // absolute path of the law to start with; empty = none
  SpineConfig spine;
  GuardConfig guard;
  BrainConfig brain;
  SwapConfig swap;
  MechanismConfig plant;
  ModelConfig model;
  std::vector<BusConfig> buses;
  std::vector<DeviceConfig> devices;
  std::vector<JointConfig> joints;
  std::vector<SensorConfig> sensors;
  std::vector<InputConfig> inputs;
  std::string values;              // what the file says, one `key = value` a line, defaults too; without `law`
  std::vector<std::string> notes;  // valid settings with a disadvantage, one sentence each
};

}  // namespace lithe::robot
