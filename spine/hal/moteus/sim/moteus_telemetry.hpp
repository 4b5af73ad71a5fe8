// SPDX-License-Identifier: Apache-2.0
// The diagnostic stream of a simulated moteus: named channels of named fields, each with a schema.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/sim/moteus_inside.hpp"

namespace lithe::hal::sim::telemetry {

inline constexpr std::size_t kChannels = 4;  // git, firmware, servo_stats, system_info
inline constexpr std::size_t kNone = kChannels;
inline constexpr std::size_t kLongestSchema = 1024;
inline constexpr std::size_t kLongestData = 128;

// Contract: RT · pure (all of these functions)
std::string_view name(std::size_t channel) LITHE_RT;
std::size_t find(std::string_view name) LITHE_RT;  // kNone for an unknown channel

// Writes the channel's type as a binary mjlib telemetry schema, or one record of that type. Returns the length; 0 when
// it does not fit (the two constants are always enough).
std::size_t write_schema(std::size_t channel, std::span<std::uint8_t> out) LITHE_RT;
std::size_t write_data(std::size_t channel, const MoteusInside& inside, std::span<std::uint8_t> out) LITHE_RT;

}  // namespace lithe::hal::sim::telemetry
