// SPDX-License-Identifier: Apache-2.0
// From a robot file's words to a bus that can be used.
#pragma once

#include <memory>
#include <utility>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// Opens the hardware behind the buses of one robot or tool, one after the other. Those of a pi3hat share their board,
// which is opened with the first of them; a connector without a bus stays silent.
// Contract: never in the tick · outlived by the buses it has opened
class BusOpener {
 public:
  // `polled`: for tools, see Pi3hatBoardParams. `port`: what stands in for the board; null = the one of this machine.
  BusOpener(std::vector<robot::BusConfig> buses, bool polled, std::unique_ptr<Pi3hatPort> port = nullptr)
      : buses_(std::move(buses)), polled_(polled), port_(std::move(port)) {}

  // One of them, of any kind but `loop`. The error says what is missing and what to do.
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
