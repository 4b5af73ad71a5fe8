// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/open_bus.hpp"

#include <utility>

#include "spine/hal/registry.hpp"

namespace lithe::hal {

Result<std::unique_ptr<Bus>> BusOpener::open(const robot::BusConfig& config) {
  const BusType& type = type_of(config.kind);
  if (type.open != nullptr) return type.open(config);
  if (type.open_board == nullptr) return Error{"bus '" + config.name + "' is simulated, there is nothing to open"};
  std::shared_ptr<BusBoard>& board = boards_[static_cast<std::size_t>(config.kind)];
  if (board == nullptr) {
    Result<std::shared_ptr<BusBoard>> opened = (open_board_ ? open_board_ : type.open_board)(buses_, polled_);
    if (!opened) return Error{"bus '" + config.name + "': " + opened.message()};
    board = std::move(*opened);
  }
  return board->open_bus(config.connector);
}

}  // namespace lithe::hal
