// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/words.hpp"

#include "spine/hal/registry.hpp"

namespace lithe::bus {

std::string drive_words(robot::DeviceKind kind, std::uint32_t joint_status) {
  const auto words = hal::type_of(kind).state_words;
  return words == nullptr ? "" : words(joint_status >> 16 & 0xff, joint_status >> 8 & 0xff);
}

}  // namespace lithe::bus
