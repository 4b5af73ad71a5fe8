// SPDX-License-Identifier: Apache-2.0
// The parts of a simulated moteus that its registers and its console share: identity, settings, servo.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/sim/servo.hpp"

namespace lithe::hal::sim {

// What the firmware says of a number that it does not have.
inline constexpr double kNotSet = std::numeric_limits<double>::quiet_NaN();

// The settings by the names of the firmware, as the console reads and writes them: those simulated here, and those that
// tools read. Each has a present value and a stored value, which is loaded at a restart.
// Contract: RT · one thread
class MoteusConfig {
 public:
  static constexpr std::size_t kEntries = 63;
  static constexpr std::size_t kNone = kEntries;

  // The initial stored values, and those of `conf default`.
  MoteusConfig(const ServoParams& servo, std::uint32_t id);

  // kNone for an unknown setting.
  static std::size_t find(std::string_view name) LITHE_RT;
  static std::string_view name(std::size_t entry) LITHE_RT;
  static bool is_integer(std::size_t entry) LITHE_RT;
  static bool is_group(std::string_view name) LITHE_RT;

  double value(std::size_t entry) const LITHE_RT { return now_[entry]; }
  // False: invalid value; the setting is unchanged.
  bool set(std::size_t entry, double value) LITHE_RT;

  void store() LITHE_RT { stored_ = now_; }
  void load() LITHE_RT { now_ = stored_; }
  void reset() LITHE_RT { now_ = factory_; }

  // Writes the settings with a name here into `params`.
  void act_on(ServoParams& params) const LITHE_RT;
  std::uint32_t id() const LITHE_RT;
  std::uint32_t prefix() const LITHE_RT;  // the upper 13 bits of the CAN ids that this drive accepts

 private:
  using Values = std::array<double, kEntries>;
  Values now_;
  Values stored_;
  Values factory_;
};

// Identity of the device.
struct MoteusIdentity {
  static constexpr std::uint32_t kFirmware = 0x010000;
  static constexpr std::uint32_t kRegisterMap = 5;
  static constexpr std::uint32_t kModel = 0;
  std::array<std::uint32_t, 3> serial{};
  std::array<std::uint8_t, 16> uuid{};

  static MoteusIdentity of(std::uint64_t serial);
  // Four bytes from 4 * `word` on, as in its register.
  std::int32_t uuid_word(std::size_t word) const LITHE_RT;
};

// Contract: RT · one thread
struct MoteusInside {
  MoteusInside(const ServoParams& params, const JointTransform& joint, const PlantParams& plant,
               const DriveErrors& errors, std::uint32_t id, std::uint64_t serial)
      : identity(MoteusIdentity::of(serial)), config(params, id), servo(params, joint, plant, errors) {}

  // Applies the present settings.
  void configure() LITHE_RT {
    ServoParams params = servo.params();
    config.act_on(params);
    servo.configure(params);
  }

  MoteusIdentity identity;
  MoteusConfig config;
  Servo servo;
};

}  // namespace lithe::hal::sim
