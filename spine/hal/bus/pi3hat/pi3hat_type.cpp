// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/pi3hat/pi3hat_type.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace lithe::hal::pi3hat {
namespace {

using robot::BusConfig;

static_assert(robot::facts(robot::BusKind::pi3hat).connectors == kPi3hatConnectors);

constexpr double kPollUs = 15;
constexpr double kPollsInSteps = 4;  // two for what is old, two for what is new (Pi3hatBoard)

// Time of an SPI transaction: hold times and bytes, header included. The figures are from the maker's library; the
// result is within 10 % of the published 740 us for twelve servos with 24 bytes out and 16 back.
constexpr double kHoldUs = 9.0;
constexpr double kByteUs = 0.8;
constexpr double kWriteHead = 10;
constexpr double kReadHead = 6;

bool is_ours(const BusConfig& bus) { return bus.kind == robot::BusKind::pi3hat; }

}  // namespace

Pi3hatBoardParams board_params(std::span<const BusConfig> buses, bool polled) {
  Pi3hatBoardParams params;
  params.polled = polled;
  params.reply_wait_ns = 0;
  for (const BusConfig& bus : buses) {
    if (!is_ours(bus)) continue;
    params.port.lines[(bus.connector - 1) % kPi3hatConnectors] = {true, bus.bitrate, bus.data_bitrate};
    params.reply_wait_ns = std::max<std::int64_t>(params.reply_wait_ns, std::llround(1e9 * bus.reply_wait_s));
  }
  return params;
}

Result<std::shared_ptr<BusBoard>> open_board(std::span<const BusConfig> buses, bool polled) {
  const Pi3hatBoardParams params = board_params(buses, polled);
  Result<std::unique_ptr<Pi3hatPort>> port = open_pi3hat_port(params.port);
  if (!port) return port.error();
  return std::shared_ptr<BusBoard>(std::make_shared<Pi3hatBoard>(std::move(*port), params));
}

std::size_t processor_of(const BusConfig& bus) {
  return std::min<std::size_t>((bus.connector - 1) / 2, kProcessors.size() - 1);
}

double transfer_us(std::size_t size, bool outbound) {
  return kHoldUs + kByteUs * (static_cast<double>(size) + (outbound ? kWriteHead : kReadHead));
}

double poll_us(std::span<const BusConfig> buses) {
  const bool in_steps =
      std::any_of(buses.begin(), buses.end(), [](const BusConfig& bus) { return is_ours(bus) && !is_fd(bus); });
  return in_steps ? kPollsInSteps * kPollUs : kPollUs;
}

}  // namespace lithe::hal::pi3hat
