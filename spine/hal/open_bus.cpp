// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/open_bus.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "spine/hal/registry.hpp"

namespace lithe::hal {

Result<std::unique_ptr<Bus>> BusOpener::open(const robot::BusConfig& config) {
  if (robot::facts(config.kind).is_board) return open_on_board(config);
  if (const BusType& type = type_of(config.kind); type.open != nullptr) return type.open(config);
  return Error{"bus '" + config.name + "' is simulated, there is nothing to open"};
}

Result<std::unique_ptr<Bus>> BusOpener::open_on_board(const robot::BusConfig& config) {
  if (board_ == nullptr) {
    Pi3hatBoardParams params;
    params.polled = polled_;
    params.reply_wait_ns = 0;
    for (const robot::BusConfig& bus : buses_) {
      if (!robot::facts(bus.kind).is_board) continue;
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
