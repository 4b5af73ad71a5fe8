// SPDX-License-Identifier: Apache-2.0
// Host side of an adapter that carries frames as text lines over a serial device.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/serial/serial_port.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/core/link.hpp"

namespace lithe::hal {

// Commands are collected and leave with flush(), in one write if the device takes them all; else the rest follows as it
// makes room. Commands not sent when the next exchange begins are dropped and counted as refused; only a partly sent
// line is still finished. Received lines are assembled from pieces of any size; a line longer than any valid one is
// dropped and counted.
//
// When the device is lost, or reports bus-off, nothing is sent or received; service() opens it again.
// Contract: as Bus · nothing is allocated between open() and the end, but in service() and why_down()
class TextBus : public Bus {
 public:
  // Must succeed before the first exchange.
  Result<> open();

  void begin(std::int64_t now_ns) LITHE_RT override;
  bool send(const Frame& frame) LITHE_RT override;
  void flush() LITHE_RT override;
  bool receive(Frame& frame) LITHE_RT override;
  // 0 while it is down or muted: no answer can come.
  std::int64_t reply_wait_ns() const LITHE_RT override { return link_.up() && !mute_ ? reply_wait_ns_ : 0; }
  void service() override;
  std::string why_down() const override;

  // Frames and commands that the adapter has confirmed; many adapters send no confirmations.
  std::uint64_t acknowledged() const LITHE_RT { return acknowledged_; }

 protected:
  enum class Said : std::uint8_t {
    frame,
    acknowledged,
    refused,        // a refused command, or a bus error
    bus_off,        // bus-off; the controller restarts when the device is opened again
    nothing,        // no answer to a command
    between_lines,  // not a line: the second byte of a line end
    malformed,
  };

  // The two line ends.
  TextBus(SerialPort port, std::int64_t reply_wait_ns, char end, char other_end)
      : port_(std::move(port)), reply_wait_ns_(reply_wait_ns), end_(end), other_end_(other_end) {}

  // Formats the line that sends a frame, with its end; 0: not possible, or it does not fit.
  virtual std::size_t format(const Frame& frame, std::span<char> out) LITHE_RT = 0;
  // `line` includes its end.
  virtual Said parse(std::string_view line, Frame& frame) LITHE_RT = 0;
  // The adapter's set-up, before the first frame.
  // Contract: never in the tick
  virtual std::string greeting() const { return ""; }
  // The adapter was opened again: forget its old state.
  virtual void forget() LITHE_RT {}

  // Final line on shutdown. Skipped when a partial line is still queued, because the adapter would read both as one
  // command.
  // Contract: never in the tick
  void say(std::string_view text);

  // send() refuses in this exchange.
  // Contract: between begin() and the first send()
  void mute(bool mute) LITHE_RT { mute_ = mute; }
  // A line without a frame, with its end, sent together with the commands. Dropped when there is no room.
  void add(std::string_view line) LITHE_RT;
  const std::string& path() const { return port_.path(); }
  const SerialIdentity& adapter() const LITHE_RT { return port_.identity(); }

 private:
  static constexpr std::size_t kLongestLine = 256;
  static constexpr std::size_t kOutbound = 16384;  // about 100 of the longest commands
  static constexpr std::size_t kInbound = 4096;    // the size of a terminal's buffer

  void drop_overtaken() LITHE_RT;
  void fill() LITHE_RT;
  bool next_frame(Frame& frame) LITHE_RT;
  bool take(char c, Frame& frame) LITHE_RT;
  bool is_end(char c) const LITHE_RT { return c == end_ || c == other_end_; }

  SerialPort port_;
  Link link_;
  std::int64_t reply_wait_ns_;
  char end_;
  char other_end_;
  std::string not_reopened_;  // why; the housekeeping's
  std::uint64_t acknowledged_ = 0;

  std::size_t out_from_ = 0;  // start of the bytes not sent yet
  std::size_t out_to_ = 0;
  bool half_gone_ = false;  // the first queued line is partly sent
  bool mute_ = false;
  std::size_t in_from_ = 0;
  std::size_t in_to_ = 0;
  std::size_t line_size_ = 0;
  bool too_long_ = false;
  std::array<char, kOutbound> out_;
  std::array<char, kInbound> in_;
  std::array<char, kLongestLine> line_;
};

}  // namespace lithe::hal
