// SPDX-License-Identifier: Apache-2.0
// For tests: a simulated pi3hat with devices on its five buses, which behaves like the maker's library.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_type.hpp"
#include "spine/hal/open_bus.hpp"
#include "spine/hal/sim/simulate.hpp"

namespace lithe::hal {

// Controls and observations of the board. Must outlive the board.
struct Board {
  std::array<LoopBus, kPi3hatConnectors> lines;
  std::array<FrameQueue, kPi3hatConnectors> wire;     // sent by devices, in order
  std::array<FrameQueue, kPi3hatConnectors> arrived;  // in the board
  sim::Nodes nodes;
  std::uint64_t cycles = 0;
  std::size_t sent = 0;      // in the last cycle
  std::size_t answered = 0;  // of those: frames that expected an answer
  std::uint32_t listen = 0;
  bool attitude_asked = false;
  bool moves = true;  // there is a new attitude
  Pi3hatAttitude attitude{{1, 0, 0, 0}, {0, 90, 0}, {0, 0, 9.8}};
  int error = 0;
  std::int64_t now_ns = 0;
  std::size_t unknown_connectors = 0;  // invented frames with connector numbers that do not exist
  bool slow = false;                   // answers arrive in the next tick
};

// As the maker's library, of whose processors one has JC1 and JC2, one JC3 and JC4, one JC5: first what is in the
// board, six frames of each processor; then it sends; then it reads until so many frames have come as answers are
// awaited, whatever they are. Each cycle takes the time of one frame on every wire.
class BoardPort final : public Pi3hatPort {
 public:
  explicit BoardPort(Board& board) : board_(board) {}

  Pi3hatOutcome cycle(const Pi3hatOrder& order, std::span<Pi3hatFrame> received, Pi3hatAttitude& attitude)
      LITHE_RT override {
    ++board_.cycles;
    board_.sent = order.send.size();
    board_.answered = 0;
    board_.listen = order.listen;
    board_.attitude_asked = order.attitude;
    pass_time();
    received_ = received;
    count_ = 0;
    for (std::size_t i = 0; i < board_.unknown_connectors && count_ < received.size(); ++i)
      received[count_++] = {static_cast<std::uint32_t>(i % 2 == 0 ? 0 : 77), false, {}};
    for (std::size_t processor = 0; processor < kProcessors; ++processor) read(processor, kMostRead);
    std::array<std::size_t, kProcessors> awaited{};
    for (const Pi3hatFrame& each : order.send) {
      board_.lines[each.connector - 1].send(each.frame);
      board_.answered += each.answered ? 1 : 0;
      awaited[(each.connector - 1) / 2] += each.answered ? 1 : 0;
    }
    hear();
    for (std::size_t processor = 0; processor < kProcessors; ++processor) await(processor, awaited[processor]);
    attitude = board_.attitude;
    return {count_, order.attitude && board_.moves, board_.error};
  }

 private:
  static constexpr std::size_t kProcessors = 3;
  static constexpr std::size_t kMostRead = 6;

  void pass_time() LITHE_RT {
    const bool next_tick = board_.now_ns != last_ns_;
    last_ns_ = board_.now_ns;
    if (next_tick) {
      for (LoopBus& line : board_.lines) line.begin(board_.now_ns);
      hear();
    }
    for (std::size_t i = 0; i < kPi3hatConnectors; ++i)
      for (bool more = next_tick || !board_.slow; more && board_.wire[i].size() > 0; more = next_tick) arrive(i);
  }
  void hear() LITHE_RT {
    Frame frame;
    for (std::size_t i = 0; i < kPi3hatConnectors; ++i)
      while (board_.lines[i].receive(frame)) board_.wire[i].push(frame);
  }
  void arrive(std::size_t i) LITHE_RT {
    board_.arrived[i].push(*board_.wire[i].front());
    board_.wire[i].pop();
  }
  // Returns the number of frames taken.
  std::size_t read(std::size_t processor, std::size_t most) LITHE_RT {
    std::size_t taken = 0;
    for (std::size_t i = std::min(2 * processor + 1, kPi3hatConnectors - 1) + 1; i-- > 2 * processor;) {
      for (FrameQueue& queue = board_.arrived[i]; queue.size() > 0 && taken < most; ++taken) {
        if (count_ == received_.size()) return taken;
        received_[count_++] = {static_cast<std::uint32_t>(i + 1), false, *queue.front()};
        queue.pop();
      }
    }
    return taken;
  }
  void await(std::size_t processor, std::size_t answers) LITHE_RT {
    answers -= std::min(answers, read(processor, kMostRead));
    for (bool any = true; any && answers > 0;) {
      any = false;
      for (std::size_t i = 2 * processor; i < std::min(2 * processor + 2, kPi3hatConnectors); ++i) {
        if (board_.wire[i].size() == 0 || board_.slow) continue;
        any = true;
        arrive(i);
      }
      answers -= std::min(answers, read(processor, kMostRead));
    }
  }

  Board& board_;
  std::span<Pi3hatFrame> received_;
  std::size_t count_ = 0;
  std::int64_t last_ns_ = -1;
};

// Opens this board in place of the machine's.
inline OpenBoard opens(Board& board) {
  return [&board](std::span<const robot::BusConfig> buses, bool polled) -> Result<std::shared_ptr<BusBoard>> {
    return std::shared_ptr<BusBoard>(
        std::make_shared<Pi3hatBoard>(std::make_unique<BoardPort>(board), pi3hat::board_params(buses, polled)));
  };
}

}  // namespace lithe::hal
