// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/open_bus.hpp"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "spine/hal/bus/fdcanusb/fdcanusb_bus.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus/socketcan/socketcan_bus.hpp"

namespace lithe::hal {
namespace {

template <class Made>
Result<std::unique_ptr<Bus>> as_bus(const robot::BusConfig& config, Result<std::unique_ptr<Made>> made) {
  if (!made) return Error{"bus '" + config.name + "': " + made.message()};
  return std::unique_ptr<Bus>(std::move(*made));
}

Checksums checksums_of(robot::Checksums wanted) {
  if (wanted == robot::Checksums::automatic) return Checksums::by_device;
  return wanted == robot::Checksums::on ? Checksums::on : Checksums::off;
}

}  // namespace

Result<std::unique_ptr<Bus>> BusOpener::open(const robot::BusConfig& config) {
  const std::int64_t wait_ns = std::llround(1e9 * config.reply_wait_s);
  const std::uint32_t baud = config.baud == 0 ? kUsualBaud : config.baud;
  switch (config.kind) {
    case robot::BusKind::fdcanusb:
      return as_bus(config, FdcanusbBus::open({.path = config.path,
                                               .checksums = checksums_of(config.checksums),
                                               .reply_wait_ns = wait_ns,
                                               .baud = baud}));
    case robot::BusKind::slcan:
      return as_bus(config, SlcanBus::open({.path = config.path,
                                            .bitrate = config.bitrate,
                                            .data_bitrate = config.data_bitrate,
                                            .reply_wait_ns = wait_ns,
                                            .baud = baud}));
    case robot::BusKind::socketcan:
      return as_bus(config, SocketCanBus::open({.interface = config.interface,
                                                .bitrate = config.bitrate,
                                                .data_bitrate = config.data_bitrate,
                                                .reply_wait_ns = wait_ns}));
    case robot::BusKind::pi3hat:
      return open_on_board(config);
    case robot::BusKind::loop:
      break;
  }
  return Error{"bus '" + config.name + "' is simulated, there is nothing to open"};
}

Result<std::unique_ptr<Bus>> BusOpener::open_on_board(const robot::BusConfig& config) {
  if (board_ == nullptr) {
    Pi3hatBoardParams params;
    params.polled = polled_;
    params.reply_wait_ns = 0;
    for (const robot::BusConfig& bus : buses_) {
      if (bus.kind != robot::BusKind::pi3hat) continue;
      params.port.lines[(bus.connector - 1) % kPi3hatConnectors] = {true, bus.bitrate, bus.data_bitrate};
      params.reply_wait_ns = std::max<std::int64_t>(params.reply_wait_ns, std::llround(1e9 * bus.reply_wait_s));
    }
    if (port_ == nullptr) {
      Result<std::unique_ptr<Pi3hatPort>> opened = open_pi3hat_port(params.port);
      if (!opened) return Error{"bus '" + config.name + "': " + opened.message()};
      port_ = std::move(*opened);
    }
    board_ = std::make_shared<Pi3hatBoard>(std::move(port_), params);
  }
  return std::unique_ptr<Bus>(std::make_unique<Pi3hatBus>(board_, config.connector));
}

}  // namespace lithe::hal
