// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/open_bus.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "spine/hal/bus/fdcanusb_bus.hpp"
#include "spine/hal/bus/slcan_bus.hpp"
#include "spine/hal/bus/socketcan_bus.hpp"

namespace lithe::hal {
namespace {

template <class Made>
Result<std::unique_ptr<Bus>> as_bus(const robot::BusConfig& config, Result<std::unique_ptr<Made>> made) {
  if (!made) return Error{"bus '" + config.name + "': " + made.message()};
  return std::unique_ptr<Bus>(std::move(*made));
}

}  // namespace

Result<std::unique_ptr<Bus>> open_bus(const robot::BusConfig& config) {
  const std::int64_t wait_ns = std::llround(1e9 * config.reply_wait_s);
  switch (config.kind) {
    case robot::BusKind::fdcanusb:
      return as_bus(config, FdcanusbBus::open({.path = config.path, .reply_wait_ns = wait_ns}));
    case robot::BusKind::slcan:
      return as_bus(config, SlcanBus::open({.path = config.path,
                                            .bitrate = config.bitrate,
                                            .data_bitrate = config.data_bitrate,
                                            .reply_wait_ns = wait_ns}));
    case robot::BusKind::socketcan:
      return as_bus(config, SocketCanBus::open({.interface = config.interface,
                                                .bitrate = config.bitrate,
                                                .data_bitrate = config.data_bitrate,
                                                .reply_wait_ns = wait_ns}));
    case robot::BusKind::pi3hat: {
      Result<std::shared_ptr<Pi3hatBoard>> board = open_pi3hat({config}, true);
      if (!board) return board.error();
      return std::unique_ptr<Bus>(std::make_unique<Pi3hatBus>(std::move(*board), config.connector));
    }
    case robot::BusKind::loop:
      break;
  }
  return Error{"bus '" + config.name + "' is simulated, there is nothing to open"};
}

Result<std::shared_ptr<Pi3hatBoard>> open_pi3hat(const std::vector<robot::BusConfig>& buses, bool polled,
                                                 std::unique_ptr<Pi3hatPort> port) {
  Pi3hatBoardParams params;
  params.polled = polled;
  params.reply_wait_ns = 0;
  std::string first;
  for (const robot::BusConfig& bus : buses) {
    if (bus.kind != robot::BusKind::pi3hat) continue;
    if (first.empty()) first = bus.name;
    params.port.lines[(bus.connector - 1) % kPi3hatConnectors] = {bus.bitrate, bus.data_bitrate};
    params.reply_wait_ns = std::max<std::int64_t>(params.reply_wait_ns, std::llround(1e9 * bus.reply_wait_s));
  }
  if (port == nullptr) {
    Result<std::unique_ptr<Pi3hatPort>> opened = open_pi3hat_port(params.port);
    if (!opened) return Error{"bus '" + first + "': " + opened.message()};
    port = std::move(*opened);
  }
  return std::make_shared<Pi3hatBoard>(std::move(port), params);
}

}  // namespace lithe::hal
