// SPDX-License-Identifier: Apache-2.0
// A simulated CiA 402 drive without its bus: state machine and control loops, on a plant.
#pragma once

#include <array>
#include <cstdint>
#include <limits>

#include "spine/core/rt.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/physics/coupled_drive.hpp"

namespace lithe::hal::sim {

struct Cia402ServoParams {
  double counts_per_rev = 4096;
  double rated_torque_nm = 1.0;      // of the motor
  double motor_torque_max_nm = 3.0;  // whatever the limits say
  double loop_hz = 20;               // bandwidth of its position and velocity loops
  double velocity_filter_hz = 200;   // of the tracking loop behind the encoder
  std::int64_t enable_ns = 0;        // from `switched on` to `operation enabled`: brake, commutation
  double velocity_unit = 1;          // unit of its reported velocity, in counts per second
};

// Values of its objects, in their units.
struct Cia402Inputs {
  cia402::Mode mode = cia402::Mode::none;
  std::int32_t target_position = 0;
  std::int32_t target_velocity = 0;
  std::int32_t target_torque = 0;
  std::int32_t position_offset = 0;
  std::int32_t velocity_offset = 0;
  std::int32_t torque_offset = 0;
  std::int32_t position_min = 0;  // equal limits are none
  std::int32_t position_max = 0;
  std::uint32_t positive_torque = 1000;  // thousandths
  std::uint32_t negative_torque = 1000;
  std::uint32_t following_window = 4096;
  std::uint32_t following_timeout_ms = 100;
  std::uint32_t deceleration = 409'600;  // counts/s^2, of quick stop and fault reaction
  std::int32_t quick_stop_option = 2;
  std::int32_t fault_reaction_option = 2;
  std::int64_t period_ns = 1'000'000;  // over which a new position is reached
};

// Modes 8, 9 and 10. Positions, velocities and stops on a ramp use one loop: a moving setpoint, with stiffness and
// damping towards it that follow from the inertia.
// Contract: as CoupledDrive
class Cia402Servo final : public CoupledDrive {
 public:
  // In torque mode a target acts after DriveErrors::delay_ns; the drive's own loops are not delayed.
  Cia402Servo(const Cia402ServoParams& params, const JointTransform& joint, const PlantParams& plant,
              const DriveErrors& errors = {});

  // Restarts the drive; the joint stays where it is.
  void restart() LITHE_RT;

  void set_inputs(const Cia402Inputs& inputs) LITHE_RT;
  void control(std::uint16_t word) LITHE_RT;
  // Applies the targets.
  void sync() LITHE_RT;

  // An error that calls for the fault reaction. It cannot be reset while `stays`, and is found again after a restart.
  void fail(std::uint16_t code, bool stays) LITHE_RT;
  void cause_gone(std::uint16_t code) LITHE_RT;  // 0: every cause
  void find_causes() LITHE_RT;                   // after a restart
  // Safe torque off (STO), as in most drives: no power, no fault, no message; it cannot be enabled meanwhile.
  void set_torque_off(bool off) LITHE_RT;
  // A limit switch: the drive does a quick stop by itself.
  void stop_at_limit() LITHE_RT;
  // The drive halts by itself: it stays on and ignores targets.
  void ignore_target(bool ignores) LITHE_RT { ignores_target_ = ignores; }
  // The reaction of object 6007h to a lost connection.
  void connection_lost(std::int32_t option, std::uint16_t code) LITHE_RT;

  cia402::State state() const LITHE_RT { return state_; }
  std::uint16_t statusword() const LITHE_RT;
  std::uint16_t error_code() const LITHE_RT { return error_code_; }
  // Counts changes of error_code(): each change sends an emergency.
  std::uint32_t error_changes() const LITHE_RT { return error_changes_; }
  std::int32_t position() const LITHE_RT;
  std::int32_t velocity() const LITHE_RT;
  std::int32_t torque() const LITHE_RT;
  std::int32_t following_error() const LITHE_RT;

 private:
  void step() LITHE_RT override;
  void enter(cia402::State state) LITHE_RT;
  void set_error(std::uint16_t code) LITHE_RT;
  void handle(std::uint16_t word) LITHE_RT;
  void hold() LITHE_RT;
  void begin_ramp() LITHE_RT;
  double motor_torque() LITHE_RT;
  double towards_demand() LITHE_RT;
  double limited(double torque_nm) LITHE_RT;
  void ramp() LITHE_RT;
  void watch_following() LITHE_RT;
  void enable() LITHE_RT;
  bool powered() const LITHE_RT;

  Cia402ServoParams params_;
  StepDelay target_nm_;
  double stiffness_nm_rev_;
  double damping_nm_s_rev_;
  Cia402Inputs inputs_;

  cia402::State state_ = cia402::State::switch_on_disabled;
  std::uint16_t last_word_ = 0;
  std::uint16_t error_code_ = 0;
  std::uint32_t error_changes_ = 0;
  std::array<std::uint16_t, 4> causes_{};  // 0 = none; further ones are dropped
  bool torque_off_ = false;
  bool ignores_target_ = false;
  std::int64_t enabling_from_ns_ = kNever;
  bool limited_ = false;
  bool following_error_ = false;
  std::int64_t behind_since_ns_ = kNever;
  std::int64_t stands_from_ns_ = 0;

  double demand_rev_ = 0;
  double demand_rev_s_ = 0;
  double goal_rev_ = 0;  // of mode 8, reached a period after its SYNC
  std::int64_t goal_ns_ = 0;

  static constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();
};

}  // namespace lithe::hal::sim
