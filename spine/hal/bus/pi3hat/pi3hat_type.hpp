// SPDX-License-Identifier: Apache-2.0
// A pi3hat in a robot file: what the registry's row needs of it. The buses of other kinds in the lists are skipped.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <span>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_bus.hpp"
#include "spine/hal/core/board.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::pi3hat {

Pi3hatBoardParams board_params(std::span<const robot::BusConfig> buses, bool polled);
// The board of this machine. The error says what is missing and the next step.
// Contract: never in the tick · one per machine
Result<std::shared_ptr<BusBoard>> open_board(std::span<const robot::BusConfig> buses, bool polled);

// Each has the buses of two connectors, the last of one.
inline constexpr std::array<std::string_view, 3> kProcessors{"JC1+JC2", "JC3+JC4", "JC5"};
std::size_t processor_of(const robot::BusConfig& bus);
// Of one frame over SPI, with so many bytes of data.
double transfer_us(std::size_t size, bool outbound);
// Of one processor that is asked for frames, in one exchange.
double poll_us(std::span<const robot::BusConfig> buses);

}  // namespace lithe::hal::pi3hat
