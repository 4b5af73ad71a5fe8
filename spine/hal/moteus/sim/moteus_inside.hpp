// SPDX-License-Identifier: Apache-2.0
// The parts of a simulated moteus that its registers and its console share.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/sim/moteus_config.hpp"
#include "spine/hal/moteus/sim/servo.hpp"

namespace lithe::hal::sim {

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
