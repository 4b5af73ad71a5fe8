// SPDX-License-Identifier: Apache-2.0
// The buses of a pi3hat: five connectors, served together by one SPI cycle per exchange.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_port.hpp"
#include "spine/hal/core/board.hpp"
#include "spine/hal/core/bus.hpp"

namespace lithe::hal {

struct Pi3hatBoardParams {
  Pi3hatParams port;
  std::int64_t reply_wait_ns = 2'000'000;
  // Polled mode (for tools): without begin(), receive() starts a cycle when its queue is empty. In the tick it would
  // wait twice.
  bool polled = false;
};

// The part that all buses of one board share. Commands of all buses are collected; the first receive() after a flush()
// sends them in one cycle, takes all answers, and gives each to the bus it came from. The board counts any frame as an
// answer, and returns frames left from the last exchange together with new ones. A moteus answer shows which command it
// belongs to; the answer of a CANopen drive does not, and has two frames. So with a classic connector an exchange has
// three steps: read old frames, send without reading, then poll until the answers are there.
// Contract: as Bus · used through Pi3hatBus and ImuSource, from one thread, but why_down()
class Pi3hatBoard final : public BusBoard, public ImuSource, public std::enable_shared_from_this<Pi3hatBoard> {
 public:
  Pi3hatBoard(std::unique_ptr<Pi3hatPort> port, const Pi3hatBoardParams& params);

  // Enables this connector (1 to 5).
  // Contract: before the first exchange
  void attach(std::uint32_t connector) {
    listen_ |= 1U << connector;
    in_steps_ = !params_.polled && (in_steps_ || !line(connector).fd);
  }
  std::unique_ptr<Bus> open_bus(std::uint32_t connector) override;
  ImuSource& want_imu() override {
    wants_imu_ = true;
    return *this;
  }

  void begin(std::int64_t now_ns) LITHE_RT;
  // False: no room, or this connector cannot send such a frame.
  bool send(std::uint32_t connector, const Frame& frame, bool answered) LITHE_RT;
  void flush() LITHE_RT;
  bool receive(std::uint32_t connector, Frame& frame) LITHE_RT;
  // 0: the cycle itself waits.
  std::int64_t reply_wait_ns() const LITHE_RT { return in_steps_ ? params_.reply_wait_ns : 0; }
  // Frames of that connector dropped since the start because the queue was full.
  std::uint64_t lost(std::uint32_t connector) const LITHE_RT { return line(connector).lost; }

  const ImuReading& imu(std::int64_t /*now_ns*/) LITHE_RT override { return imu_; }
  std::string why_down() const;

  std::uint64_t cycles() const LITHE_RT { return cycles_; }

 private:
  static constexpr std::size_t kMostSent = 128;      // four times the longest queue of the board
  static constexpr std::size_t kMostReceived = 160;  // all its queues, full
  // Number of cycles to empty the board: each cycle takes at least six frames from every processor that has some, and a
  // processor holds at most 64.
  static constexpr std::size_t kLeastTaken = 6;  // fewer than this in total: the board is empty
  static constexpr int kMostOldCycles = 11;

  struct Line {
    FrameQueue inbound;
    bool fd = true;
    std::uint64_t lost = 0;
  };
  Line& line(std::uint32_t connector) LITHE_RT { return lines_[connector - 1]; }
  const Line& line(std::uint32_t connector) const LITHE_RT { return lines_[connector - 1]; }
  void look(std::uint32_t connector) LITHE_RT;
  void take_old() LITHE_RT;
  void send_all(std::int64_t wait_ns, std::span<Pi3hatFrame> room) LITHE_RT;
  // Returns how many frames came.
  std::size_t cycle(const Pi3hatOrder& order, std::span<Pi3hatFrame> room) LITHE_RT;
  void take(const Pi3hatAttitude& attitude) LITHE_RT;

  std::unique_ptr<Pi3hatPort> port_;
  Pi3hatBoardParams params_;
  std::uint32_t listen_ = 0;
  bool wants_imu_ = false;
  bool in_steps_ = false;
  bool open_ = false;         // between begin() and flush()
  bool old_ = false;          // frames since the last exchange are still in the board
  bool due_ = false;          // commands are not sent yet
  std::uint32_t looked_ = 0;  // bits 1 to 5: connectors that have received since the last cycle
  std::int64_t now_ns_ = 0;
  std::uint64_t cycles_ = 0;
  std::size_t sent_ = 0;
  ImuReading imu_;
  std::atomic<int> error_{0};  // relaxed: only reported by why_down()
  std::array<Pi3hatFrame, kMostSent> outbound_;
  std::array<Pi3hatFrame, kMostReceived> inbound_;
  std::array<Line, kPi3hatConnectors> lines_;
};

// One connector.
// Contract: as Bus
class Pi3hatBus final : public Bus {
 public:
  Pi3hatBus(std::shared_ptr<Pi3hatBoard> board, std::uint32_t connector)
      : board_(std::move(board)), connector_(connector) {
    board_->attach(connector);
  }

  void begin(std::int64_t now_ns) LITHE_RT override { board_->begin(now_ns); }
  void expect_answer() LITHE_RT override { answered_ = true; }
  bool send(const Frame& frame) LITHE_RT override;
  void flush() LITHE_RT override;
  bool receive(Frame& frame) LITHE_RT override;
  std::int64_t reply_wait_ns() const LITHE_RT override { return board_->reply_wait_ns(); }
  std::string why_down() const override { return board_->why_down(); }

 private:
  std::shared_ptr<Pi3hatBoard> board_;
  std::uint32_t connector_;
  bool answered_ = false;
};

}  // namespace lithe::hal
