// SPDX-License-Identifier: Apache-2.0
// Keys of a [[device]] that only a CiA 401 module has.
#pragma once

#include <cstddef>
#include <cstdint>

#include "spine/robot/read/joint_demand.hpp"

namespace lithe::hal::cia401 {

inline constexpr std::size_t kDigital = 16;  // channels at most
inline constexpr std::size_t kAnalog = 12;

// The inputs of one module that are used.
struct Inputs {
  std::uint32_t digital = 8;
  std::uint32_t analog = 0;
};

struct Keys {
  Inputs inputs{};
  double send_every_s = 0.01;
};

// `watchdog_s`: of the device.
void read_keys(robot::Reader& in, Keys& keys, double watchdog_s);

}  // namespace lithe::hal::cia401
