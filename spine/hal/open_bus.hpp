// SPDX-License-Identifier: Apache-2.0
// Opens the buses of a robot file.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/core/board.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// Opens the board on which `buses` of its kind are. `polled`: as BusOpener.
using OpenBoard =
    std::function<Result<std::shared_ptr<BusBoard>>(std::span<const robot::BusConfig> buses, bool polled)>;

// Opens the buses of one robot or tool. Buses on a board share it: it is opened with the first of them; a connector
// without a bus stays silent.
// Contract: never in the tick · may be destroyed before the buses it has opened
class BusOpener {
 public:
  // `polled`: for tools, which look for frames without a command before. `open_board`: replaces the board (for tests);
  // empty = the board of this machine.
  BusOpener(std::vector<robot::BusConfig> buses, bool polled, OpenBoard open_board = {})
      : buses_(std::move(buses)), polled_(polled), open_board_(std::move(open_board)) {}

  // Opens one bus of any kind but `loop`. The error says what is missing and the next step.
  Result<std::unique_ptr<Bus>> open(const robot::BusConfig& config);

  // Contract: a bus of this kind has been opened, and is on a board
  BusBoard& board(robot::BusKind kind) const { return *boards_[static_cast<std::size_t>(kind)]; }

 private:
  std::vector<robot::BusConfig> buses_;
  bool polled_;
  OpenBoard open_board_;
  std::array<std::shared_ptr<BusBoard>, robot::kBusFacts.size()> boards_;  // by BusKind
};

}  // namespace lithe::hal
