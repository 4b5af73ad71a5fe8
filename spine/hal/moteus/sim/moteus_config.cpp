// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/sim/moteus_config.hpp"

#include <cmath>
#include <limits>

#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal::sim {
namespace {

constexpr double kAnything = std::numeric_limits<double>::infinity();

struct Entry {
  std::string_view name;
  bool integer;
  double factory;
  double ServoParams::* acts = nullptr;  // the servo parameter it sets
  double least = -kAnything;
  double most = kAnything;
};

constexpr std::array<Entry, MoteusConfig::kEntries> kTable{{
    {"id.id", true, 1, nullptr, 1, 126},
    {"can.prefix", true, 0, nullptr, 0, 0x1fff},
    {"servo.pwm_rate_hz", true, 30000},
    {"servo.current_sense_ohm", false, 0.0005},
    {"servo.max_voltage", false, 46},
    {"servo.max_power_W", false, kNotSet},
    {"servo.override_board_max_power", true, 0, nullptr, 0, 1},
    {"servo.temperature_margin", false, 25, &ServoParams::temperature_margin_c},
    {"servo.fault_temperature", false, 75, &ServoParams::fault_temperature_c},
    {"servo.enable_motor_temperature", true, 0, nullptr, 0, 1},
    {"servo.motor_thermistor_ohm", false, 10000},
    {"servo.motor_temperature_margin", false, 20},
    {"servo.motor_fault_temperature", false, kNotSet},
    {"servo.fault_position_error", false, kNotSet},
    {"servo.fault_velocity_error", false, kNotSet},
    {"servo.velocity_threshold", false, 0},
    {"servo.position_derate", false, 0.02},
    {"servo.adc_cur_cycles", true, 2},
    {"servo.adc_aux_cycles", true, 47},
    {"servo.pid_dq_hz", false, 100},
    {"servo.max_current_desired_rate", false, 10000},
    {"servo.pid_position.kp", false, 4, &ServoParams::kp_nm_rev},
    {"servo.pid_position.ki", false, 1, &ServoParams::ki_nm_rev_s},
    {"servo.pid_position.kd", false, 0.05, &ServoParams::kd_nm_s_rev},
    {"servo.pid_position.iratelimit", false, -1},
    {"servo.pid_position.ilimit", false, 0, &ServoParams::integral_limit_nm},
    {"servo.pid_position.max_desired_rate", false, 0},
    {"servo.pid_position.sign", false, -1},
    {"servo.current_feedforward", false, 1},
    {"servo.bemf_feedforward", false, 0},
    {"servo.bemf_feedforward_override", true, 0, nullptr, 0, 1},
    {"servo.cross_coupling_feedforward", false, 1},
    {"servo.inertia_feedforward", false, 0},
    {"servo.default_velocity_limit", false, kNotSet, &ServoParams::default_velocity_limit_rev_s},
    {"servo.default_accel_limit", false, 50, &ServoParams::default_acceleration_limit_rev_s2},
    {"servo.voltage_mode_control", true, 0, nullptr, 0, 1},
    {"servo.fixed_voltage_mode", true, 0, nullptr, 0, 1},
    {"servo.fixed_voltage_control_V", false, 0},
    {"servo.max_position_slip", false, kNotSet},
    {"servo.max_velocity_slip", false, kNotSet},
    {"servo.default_timeout_s", false, 0.1, &ServoParams::default_watchdog_s},
    {"servo.timeout_max_torque_Nm", false, 5, &ServoParams::timeout_max_torque_nm},
    {"servo.timeout_mode", true, 12, &ServoParams::timeout_mode, 0, 15},
    {"servo.flux_brake_margin_voltage", false, 3},
    {"servo.flux_brake_resistance_ohm", false, 0.025},
    {"servo.max_regen_power_W", false, kNotSet},
    {"servo.max_current_A", false, 100},
    {"servo.derate_current_A", false, -20},
    {"servo.max_velocity", false, 500},
    {"servo.max_velocity_derate", false, 2},
    {"servopos.position_min", false, kNotSet, &ServoParams::position_min_rev},
    {"servopos.position_max", false, kNotSet, &ServoParams::position_max_rev},
    {"motor.poles", true, 14, nullptr, 0, 255},
    {"motor.phase_invert", true, 0, nullptr, 0, 1},
    {"motor.resistance_ohm", false, 0.047, &ServoParams::resistance_ohm},
    {"motor.inductance_d_H", false, 26e-6},
    {"motor.inductance_q_H", false, 45.8e-6},
    {"motor.Kv", false, 304},
    {"motor_position.commutation_source", true, 0, nullptr, 0, 2},
    {"motor_position.output.source", true, 0, nullptr, 0, 2},
    {"motor_position.output.offset", false, 0},
    {"motor_position.output.sign", true, 1, nullptr, -1, 1},
    {"motor_position.rotor_to_output_ratio", false, 1},
}};
static_assert(!kTable.back().name.empty());
constexpr std::size_t kId = 0;
constexpr std::size_t kPrefix = 1;

}  // namespace

MoteusConfig::MoteusConfig(const ServoParams& servo, std::uint32_t id) {
  for (std::size_t i = 0; i < kEntries; ++i)
    factory_[i] = kTable[i].acts != nullptr ? servo.*kTable[i].acts : kTable[i].factory;
  factory_[kId] = id;
  now_ = stored_ = factory_;
}

std::size_t MoteusConfig::find(std::string_view name) LITHE_RT {
  std::size_t entry = 0;
  while (entry < kEntries && kTable[entry].name != name) ++entry;
  return entry;
}

std::string_view MoteusConfig::name(std::size_t entry) LITHE_RT { return kTable[entry].name; }

bool MoteusConfig::is_integer(std::size_t entry) LITHE_RT { return kTable[entry].integer; }

bool MoteusConfig::is_group(std::string_view name) LITHE_RT {
  for (const Entry& entry : kTable) {
    std::string_view rest = entry.name;
    if (next_field(rest, '.') == name) return true;
  }
  return false;
}

bool MoteusConfig::set(std::size_t entry, double value) LITHE_RT {
  const Entry& e = kTable[entry];
  constexpr double kLargest = 2147483647;
  if (e.integer && !(std::abs(value) <= kLargest)) return false;
  if (value < e.least || value > e.most) return false;
  now_[entry] = e.integer ? std::trunc(value) : value;
  return true;
}

void MoteusConfig::act_on(ServoParams& params) const LITHE_RT {
  for (std::size_t i = 0; i < kEntries; ++i)
    if (kTable[i].acts != nullptr) params.*kTable[i].acts = now_[i];
}

std::uint32_t MoteusConfig::id() const LITHE_RT { return static_cast<std::uint32_t>(now_[kId]); }
std::uint32_t MoteusConfig::prefix() const LITHE_RT { return static_cast<std::uint32_t>(now_[kPrefix]); }

}  // namespace lithe::hal::sim
