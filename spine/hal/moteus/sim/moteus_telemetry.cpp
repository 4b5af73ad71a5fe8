// SPDX-License-Identifier: Apache-2.0
// One table describes each channel; schema and data are both written from it, so they always agree.
#include "spine/hal/moteus/sim/moteus_console.hpp"

#include <array>
#include <bit>
#include <numbers>

namespace lithe::hal::sim::telemetry {
namespace {

// Type numbers of the schema.
constexpr std::uint8_t kBoolean = 2;
constexpr std::uint8_t kUnsigned = 4;  // followed by its size in bytes
constexpr std::uint8_t kFloat = 7;
constexpr std::uint8_t kObject = 16;
constexpr std::uint8_t kEnum = 17;
constexpr std::uint8_t kFixedArray = 19;

enum class Type : std::uint8_t { boolean, u8, u32, u64, f32, mode };

struct Field {
  std::string_view name;
  Type type;
  std::uint8_t count = 0;  // of an array; 0 = not an array
};

constexpr Field kGit[] = {{"hash", Type::u8, 20}, {"dirty", Type::boolean}, {"timestamp", Type::u64}};
constexpr Field kFirmware[] = {{"version", Type::u32},
                               {"serial_number", Type::u32, 3},
                               {"model", Type::u32},
                               {"family", Type::u8},
                               {"hwrev", Type::u8}};
constexpr Field kServoStats[] = {{"mode", Type::mode},
                                 {"fault", Type::u32},
                                 {"bus_V", Type::f32},
                                 {"filt_bus_V", Type::f32},
                                 {"fet_temp_C", Type::f32},
                                 {"motor_temp_C", Type::f32},
                                 {"d_A", Type::f32},
                                 {"q_A", Type::f32},
                                 {"position", Type::f32},
                                 {"velocity", Type::f32},
                                 {"torque_Nm", Type::f32},
                                 {"power_W", Type::f32},
                                 {"control_position", Type::f32},
                                 {"control_velocity", Type::f32},
                                 {"trajectory_done", Type::boolean}};
constexpr Field kSystemInfo[] = {{"ms_count", Type::u32}};

struct Channel {
  std::string_view name;
  std::span<const Field> fields;
};
constexpr std::array<Channel, kChannels> kTable{
    {{"git", kGit}, {"firmware", kFirmware}, {"servo_stats", kServoStats}, {"system_info", kSystemInfo}}};

constexpr std::array<std::string_view, 16> kModes{
    "stopped",    "fault",   "enabling", "calibrating", "calib_complete", "pwm",    "voltage",  "voltage_foc",
    "voltage_dq", "current", "position", "pos_timeout", "zero_vel",       "within", "meas_ind", "brake"};

class Out {
 public:
  explicit Out(std::span<std::uint8_t> buffer) LITHE_RT : buffer_(buffer) {}

  void byte(std::uint8_t value) LITHE_RT {
    fits_ = fits_ && size_ < buffer_.size();
    if (fits_) buffer_[size_++] = value;
  }
  void text(std::string_view value) LITHE_RT {  // shorter than 128 bytes, so its length is one
    byte(static_cast<std::uint8_t>(value.size()));
    for (const char c : value) byte(static_cast<std::uint8_t>(c));
  }
  void number(std::uint64_t value, unsigned bytes) LITHE_RT {
    for (unsigned i = 0; i < bytes; ++i) byte(static_cast<std::uint8_t>(value >> (8 * i)));
  }
  void real(double value) LITHE_RT { number(std::bit_cast<std::uint32_t>(static_cast<float>(value)), 4); }
  std::size_t length() const LITHE_RT { return fits_ ? size_ : 0; }

 private:
  std::span<std::uint8_t> buffer_;
  std::size_t size_ = 0;
  bool fits_ = true;
};

void write_type(Type type, Out& out) LITHE_RT {
  if (type == Type::boolean) return out.byte(kBoolean);
  if (type == Type::f32) return out.byte(kFloat);
  if (type == Type::mode) out.byte(kEnum);
  out.byte(kUnsigned);
  out.byte(type == Type::u32 ? 4 : type == Type::u64 ? 8 : 1);
  if (type != Type::mode) return;
  out.byte(kModes.size());
  for (std::size_t i = 0; i < kModes.size(); ++i) {
    out.byte(static_cast<std::uint8_t>(i));
    out.text(kModes[i]);
  }
}

void write_servo(const Servo& servo, Out& out) LITHE_RT {
  const ServoParams& params = servo.params();
  const double torque_nm = servo.torque_nm();
  out.byte(static_cast<std::uint8_t>(servo.mode()));
  out.number(servo.fault(), 4);
  for (const double value : {params.supply_v, params.supply_v, params.temperature_c, params.temperature_c, 0.0,
                             torque_nm / params.torque_constant_nm_a, servo.position_rev(), servo.velocity_rev_s(),
                             torque_nm, torque_nm * servo.velocity_rev_s() * 2 * std::numbers::pi,
                             servo.control_position_rev(), servo.control_velocity_rev_s()}) {
    out.real(value);
  }
  out.byte(servo.trajectory_complete() ? 1 : 0);
}

void write_firmware(const MoteusIdentity& identity, Out& out) LITHE_RT {
  out.number(MoteusIdentity::kFirmware, 4);
  for (const std::uint32_t word : identity.serial) out.number(word, 4);
  out.number(MoteusIdentity::kModel, 4);
  out.byte(0);
  constexpr std::uint8_t kHardwareRevision = 8;
  out.byte(kHardwareRevision);
}

}  // namespace

std::string_view name(std::size_t channel) LITHE_RT { return kTable[channel].name; }

std::size_t find(std::string_view name) LITHE_RT {
  std::size_t channel = 0;
  while (channel < kChannels && kTable[channel].name != name) ++channel;
  return channel;
}

std::size_t write_schema(std::size_t channel, std::span<std::uint8_t> buffer) LITHE_RT {
  Out out(buffer);
  out.byte(kObject);
  out.byte(0);  // no version
  for (const Field& field : kTable[channel].fields) {
    out.byte(0);
    out.text(field.name);
    out.byte(0);  // no other names
    if (field.count > 0) {
      out.byte(kFixedArray);
      out.byte(field.count);
    }
    write_type(field.type, out);
    out.byte(0);  // no default
  }
  for (int i = 0; i < 5; ++i) out.byte(0);  // a field without name and type ends the list
  return out.length();
}

std::size_t write_data(std::size_t channel, const MoteusInside& inside, std::span<std::uint8_t> buffer) LITHE_RT {
  Out out(buffer);
  if (kTable[channel].name == "git") {
    for (int i = 0; i < 20; ++i) out.byte(0);  // no commit hash
    out.byte(0);
    out.number(0, 8);
  } else if (kTable[channel].name == "firmware") {
    write_firmware(inside.identity, out);
  } else if (kTable[channel].name == "servo_stats") {
    write_servo(inside.servo, out);
  } else {
    out.number(static_cast<std::uint64_t>(inside.servo.time_ns() / 1'000'000), 4);
  }
  return out.length();
}

}  // namespace lithe::hal::sim::telemetry
