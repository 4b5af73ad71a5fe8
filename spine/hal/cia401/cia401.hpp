// SPDX-License-Identifier: Apache-2.0
// The profile CiA 401 for input modules: objects, process data. Pure.
//
// TPDO1 has the digital inputs, eight in a byte (6000h:1 is inputs 0 to 7); TPDO2 to TPDO4 the analog ones, four 16-bit
// numbers each (6401h:1 is input 0). The module sends each by its own clock.
#pragma once

#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/cia401/keys/cia401_keys.hpp"

namespace lithe::hal::cia401 {

namespace object {
inline constexpr std::uint16_t kDigitalInputs = 0x6000;    // :n = inputs 8 n - 8 to 8 n - 1
inline constexpr std::uint16_t kAnalogInputs = 0x6401;     // :n = input n - 1
inline constexpr std::uint16_t kAnalogInterrupt = 0x6423;  // 1: analog inputs are sent; 0, after power-on, they are not
}  // namespace object

inline constexpr std::uint32_t kDeviceProfile = 401;  // low half of object 1000h
inline constexpr std::size_t kPdos = 4;
inline constexpr std::size_t kAnalogPerPdo = 4;

constexpr std::uint32_t pdo_id(std::size_t number, std::uint32_t node) LITHE_RT {
  return canopen::cob::kTpdo1 + static_cast<std::uint32_t>(number) * canopen::cob::kNextPdo + node;
}

// Of TPDO `number` (0 to 3). Empty: it is off.
constexpr canopen::PdoMap pdo_map(std::size_t number, const Inputs& inputs) LITHE_RT {
  canopen::PdoMap map;
  if (number == 0) {
    for (std::uint32_t first = 0; first < inputs.digital; first += 8)
      map.add({{object::kDigitalInputs, static_cast<std::uint8_t>(1 + first / 8)}, 1});
    return map;
  }
  for (std::size_t i = (number - 1) * kAnalogPerPdo; i < number * kAnalogPerPdo && i < inputs.analog; ++i)
    map.add({{object::kAnalogInputs, static_cast<std::uint8_t>(1 + i)}, 2});
  return map;
}

}  // namespace lithe::hal::cia401
