// SPDX-License-Identifier: Apache-2.0
// What the registers and the console of a simulated moteus both reach.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/sim/moteus_config.hpp"
#include "spine/hal/moteus/sim/servo.hpp"

namespace lithe::hal::sim {

// Who the device says it is. Same serial, same device.
struct MoteusIdentity {
  static constexpr std::uint32_t kFirmware = 0x010000;
  static constexpr std::uint32_t kRegisterMap = 5;
  static constexpr std::uint32_t kModel = 0;
  std::array<std::uint32_t, 3> serial{};
  std::array<std::uint8_t, 16> uuid{};

  static MoteusIdentity of(std::uint64_t serial);
  // The four bytes from 4 * `word` on, as its register tells them.
  std::int32_t uuid_word(std::size_t word) const LITHE_RT;
};

// Contract: RT · one thread
struct MoteusInside {
  MoteusInside(const ServoParams& params, const JointTransform& joint, const PlantParams& plant,
               const DriveErrors& errors, std::uint32_t id, std::uint64_t serial)
      : identity(MoteusIdentity::of(serial)), config(params, id), servo(params, joint, plant, errors) {}

  // Whatever the settings say now acts.
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
