// SPDX-License-Identifier: Apache-2.0
// Opens the buses of a robot file.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_bus.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// Opens the buses of one robot or tool. The buses of a pi3hat share their board, which is opened with the first of
// them; a connector without a bus stays silent.
// Contract: never in the tick · may be destroyed before the buses it has opened
class BusOpener {
 public:
  // `polled`: for tools, see Pi3hatBoardParams. `port`: replaces the board (for tests); null = the board of this
  // machine.
  BusOpener(std::vector<robot::BusConfig> buses, bool polled, std::unique_ptr<Pi3hatPort> port = nullptr)
      : buses_(std::move(buses)), polled_(polled), port_(std::move(port)) {}

  // Opens one bus of any kind but `loop`. The error says what is missing and the next step.
  Result<std::unique_ptr<Bus>> open(const robot::BusConfig& config);

  // Null before a bus of kind pi3hat has been opened.
  const std::shared_ptr<Pi3hatBoard>& board() const { return board_; }

 private:
  Result<std::unique_ptr<Bus>> open_on_board(const robot::BusConfig& config);

  std::vector<robot::BusConfig> buses_;
  bool polled_;
  std::unique_ptr<Pi3hatPort> port_;
  std::shared_ptr<Pi3hatBoard> board_;
};

}  // namespace lithe::hal
