// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace lithe::hal::cia402 {
namespace {

struct Pattern {
  std::uint16_t mask;
  std::uint16_t bits;
  std::string_view name;
};

// By State. Bit 5 is part of a state only where the drive can be switched on.
constexpr std::array<Pattern, 8> kPatterns{{{0x4f, 0x00, "not ready to switch on"},
                                            {0x4f, 0x40, "switch on disabled"},
                                            {0x6f, 0x21, "ready to switch on"},
                                            {0x6f, 0x23, "switched on"},
                                            {0x6f, 0x27, "operation enabled"},
                                            {0x6f, 0x07, "quick stop active"},
                                            {0x4f, 0x0f, "fault reaction active"},
                                            {0x4f, 0x08, "fault"}}};

}  // namespace

std::string_view state_name(State state) LITHE_RT { return kPatterns[static_cast<std::size_t>(state) & 7].name; }

bool decode_state(std::uint16_t statusword, State& state) LITHE_RT {
  for (std::size_t i = 0; i < kPatterns.size(); ++i) {
    if ((statusword & kPatterns[i].mask) != kPatterns[i].bits) continue;
    state = static_cast<State>(i);
    return true;
  }
  return false;
}

std::uint16_t encode_state(State state) LITHE_RT { return kPatterns[static_cast<std::size_t>(state) & 7].bits; }

std::uint16_t control_to_enable(State state) LITHE_RT {
  if (state == State::switch_on_disabled) return control::kShutdown;
  if (state == State::ready_to_switch_on) return control::kSwitchOn;
  if (state == State::switched_on || state == State::operation_enabled) return control::kEnable;
  return control::kDisableVoltage;  // a quick stop leads to `switch on disabled` at once, whatever its option says
}

std::uint32_t raw_counts(double value) LITHE_RT {
  constexpr double kMost = 2147483647.0;
  if (std::isnan(value)) return 0;
  return static_cast<std::uint32_t>(static_cast<std::int32_t>(std::round(std::clamp(value, -kMost, kMost))));
}

}  // namespace lithe::hal::cia402
