// SPDX-License-Identifier: Apache-2.0
// A simulated moteus without its bus: modes, watchdog, control law, on a plant.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "spine/core/rt.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"
#include "spine/hal/physics/coupled_drive.hpp"

namespace lithe::hal::sim {

// Configuration of the drive, in its own units: revolutions of the motor, torque at the motor.
struct ServoParams {
  double kp_nm_rev = 4.0;
  double ki_nm_rev_s = 1.0;
  double kd_nm_s_rev = 0.05;
  double integral_limit_nm = 0.0;  // factory default: no integral
  double default_watchdog_s = 0.1;
  double default_velocity_limit_rev_s = kNone;
  double default_acceleration_limit_rev_s2 = 50.0;
  double position_min_rev = kNone;
  double position_max_rev = kNone;
  double timeout_max_torque_nm = 5.0;
  double timeout_mode = 12;     // action of the watchdog: 10 hold, 12 damp, 15 brake, any other: limp
  double home_at_power_on = 2;  // the home state then: 0 relative, 1 rotor, 2 output, as with an encoder there
  double fault_temperature_c = 75.0;
  double temperature_margin_c = 25.0;  // torque is reduced from this far below the limit
  double motor_torque_max_nm = 1.65;   // an mj5208 at 100 A
  double torque_constant_nm_a = 0.0273;
  double resistance_ohm = 0.047;
  std::uint32_t encoder_counts = 16384;  // per revolution
  double velocity_filter_hz = 200;       // bandwidth of the tracking loop behind the encoder
  double supply_v = 24.0;
  double temperature_c = 25.0;
  static constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
};

// The command registers, with the values after a write of the mode.
struct ServoCommand {
  static constexpr double kAbsent = std::numeric_limits<double>::quiet_NaN();
  double q_current_a = 0;
  double d_current_a = 0;
  double position_rev = 0;  // NaN: where it is now
  double velocity_rev_s = 0;
  double torque_nm = 0;
  double kp_scale = 1;
  double kd_scale = 1;
  double max_torque_nm = kAbsent;
  double stop_position_rev = kAbsent;
  double watchdog_s = 0;                  // 0: as configured; NaN: none
  double velocity_limit_rev_s = kAbsent;  // NaN: as configured; negative: none
  double acceleration_limit_rev_s2 = kAbsent;
  double fixed_voltage_v = kAbsent;
  double integral_scale = 1;
  double fixed_current_a = kAbsent;
  double ignore_bounds = 0;
  double lower_bound_rev = kAbsent;  // of stay_within
  double upper_bound_rev = kAbsent;
};

// Contract: as CoupledDrive
class Servo final : public CoupledDrive {
 public:
  Servo(const ServoParams& params, const JointTransform& joint, const PlantParams& plant,
        const DriveErrors& errors = {});

  // Power cycle: stopped, without fault, command or own limits. The plant continues.
  void restart(const ServoParams& params) LITHE_RT;

  // Changed settings act from the next step on. The plant's own constants do not change.
  void configure(const ServoParams& params) LITHE_RT {
    params_ = params;
    set_encoder(encoder_of(params));
    judge_health();
  }

  // Sets the present position to this value: `exact`, or the nearest value by whole turns. The drive is homed then.
  void set_output(double position_rev, bool exact) LITHE_RT;

  // Homing is lost.
  void require_reindex() LITHE_RT { home_ = 0; }
  // 0 relative, 1 rotor, 2 output.
  double home() const LITHE_RT { return encoder_lost_ ? 0 : home_; }

  // Sets the setpoint of a running position command to the present position and velocity.
  void recapture() LITHE_RT;

  // Fault injection for tests and `lithe sim`: over-temperature, lost encoder.
  void set_temperature_c(double temperature_c) LITHE_RT {
    params_.temperature_c = temperature_c;
    judge_health();
  }
  void set_encoder_lost(bool lost) LITHE_RT {
    encoder_lost_ = lost;
    judge_health();
  }
  void set_driver_failed(bool failed) LITHE_RT {
    driver_failed_ = failed;
    judge_health();
  }
  void expire_watchdog() LITHE_RT {
    if (watchdog_end_ns_ != kNever) watchdog_end_ns_ = time_ns_;
  }

  // A command in the same mode takes effect after DriveErrors::delay_ns. A change of mode takes effect at once, so that
  // the reply shows it, and drops delayed commands. After a fault or timeout only `stopped` is accepted.
  void apply(moteus::Mode mode, const ServoCommand& command) LITHE_RT;

  moteus::Mode mode() const LITHE_RT { return mode_; }
  std::uint32_t fault() const LITHE_RT { return fault_; }
  // NaN while the encoder is lost.
  double position_rev() const LITHE_RT { return encoder_lost_ ? ServoParams::kNone : encoder_rev_; }
  double velocity_rev_s() const LITHE_RT { return encoder_lost_ ? ServoParams::kNone : velocity_rev_s_; }
  double torque_nm() const LITHE_RT;  // 0 unless driving
  double control_position_rev() const LITHE_RT { return control_position_rev_; }
  double control_velocity_rev_s() const LITHE_RT { return control_velocity_rev_s_; }
  double control_torque_nm() const LITHE_RT { return wanted_nm_; }
  // The terms of the control law in the last step, and their errors.
  struct Terms {
    double p_nm = 0, i_nm = 0, d_nm = 0;
    double error_rev = 0, error_rev_s = 0;
  };
  const Terms& terms() const LITHE_RT { return terms_; }
  const ServoCommand& command() const LITHE_RT { return command_; }
  bool encoder_lost() const LITHE_RT { return encoder_lost_; }
  bool trajectory_complete() const LITHE_RT { return trajectory_complete_; }
  std::int64_t time_ns() const LITHE_RT { return time_ns_; }
  const ServoParams& params() const LITHE_RT { return params_; }

 private:
  void step() LITHE_RT override;
  void on_skip() LITHE_RT override;
  static Encoder encoder_of(const ServoParams& params) LITHE_RT {
    return {static_cast<double>(params.encoder_counts), params.velocity_filter_hz};
  }
  void check_watchdog() LITHE_RT;
  void enter(moteus::Mode mode) LITHE_RT;
  void handle(moteus::Mode mode, const ServoCommand& command) LITHE_RT;
  void handle_due() LITHE_RT;
  void start_command() LITHE_RT;
  void fail(std::uint32_t fault) LITHE_RT;
  void move_set_point() LITHE_RT;
  void plan_velocity() LITHE_RT;
  double motor_torque() LITHE_RT;
  double position_torque() LITHE_RT;
  double within_torque() LITHE_RT;
  double damping_torque() LITHE_RT;
  double timeout_torque() LITHE_RT;
  double brake_torque() LITHE_RT;
  void judge_health() LITHE_RT;
  double torque_limit() LITHE_RT;
  double pd(double position_rev, double velocity_rev_s) LITHE_RT;
  bool outside_bounds() const LITHE_RT;
  bool driving(moteus::Mode mode) const LITHE_RT;

  // Delayed commands. The bus brings at most one per tick; when the buffer is full, the oldest acts early.
  static constexpr std::size_t kOnTheWay = 16;
  struct Underway {
    std::int64_t due_ns = 0;
    moteus::Mode mode{};
    ServoCommand command;
  };

  ServoParams params_;
  std::array<Underway, kOnTheWay> underway_{};  // a ring
  std::size_t first_underway_ = 0, underway_count_ = 0;

  moteus::Mode mode_ = moteus::Mode::stopped;
  moteus::Mode target_ = moteus::Mode::stopped;  // the mode after the calibration
  std::uint32_t fault_ = 0;
  ServoCommand command_;
  std::int64_t phase_end_ns_ = 0;
  std::int64_t watchdog_end_ns_ = kNever;

  double home_ = 0;
  bool encoder_lost_ = false;
  bool driver_failed_ = false;
  std::uint32_t ailment_ = 0;          // injected fault, raised when driving
  double hot_torque_max_nm_ = kNoEnd;  // torque limit by temperature; infinite while cool

  double control_position_rev_ = 0;
  double control_velocity_rev_s_ = 0;
  double goal_rev_ = 0;            // goal of the planner; moves with the commanded velocity
  double velocity_limit_ = 0;      // NaN: none
  double acceleration_limit_ = 0;  // NaN: none
  double wanted_nm_ = 0;
  Terms terms_;
  bool trajectory_complete_ = false;

  static constexpr double kNoEnd = std::numeric_limits<double>::infinity();
  static constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();
};

}  // namespace lithe::hal::sim
