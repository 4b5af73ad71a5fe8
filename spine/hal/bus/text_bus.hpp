// SPDX-License-Identifier: Apache-2.0
// The host's end of an adapter that carries frames as lines of text over a serial device.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/bus.hpp"
#include "spine/hal/bus/frame.hpp"
#include "spine/hal/bus/link.hpp"
#include "spine/hal/bus/serial_port.hpp"

namespace lithe::hal {

// Commands are collected and leave with flush(), in one write if the device takes them all; else the rest follows as it
// makes room. What has not left when the next exchange begins is overtaken by its commands: only a line that is half
// gone is still finished, the others are refused. Lines that come in are put together from whatever pieces arrive;
// one that is longer than any that means something is dropped and counted.
//
// When the device goes away, or says that its controller is bus-off, nothing is sent or received; service() opens it
// again.
// Contract: as Bus · nothing is allocated between open() and the end, but in service() and why_down()
class TextBus : public Bus {
 public:
  // Must succeed before the first exchange.
  Result<> open();

  void begin(std::int64_t now_ns) LITHE_RT override;
  bool send(const Frame& frame) LITHE_RT override;
  void flush() LITHE_RT override;
  bool receive(Frame& frame) LITHE_RT override;
  // 0 while it is down or mute: nothing is worth waiting for.
  std::int64_t reply_wait_ns() const LITHE_RT override { return link_.up() && !mute_ ? reply_wait_ns_ : 0; }
  void service() override;
  std::string why_down() const override;

  // Frames and commands that the adapter said it has taken; many never say so.
  std::uint64_t acknowledged() const LITHE_RT { return acknowledged_; }

 protected:
  enum class Said : std::uint8_t {
    frame,
    acknowledged,
    refused,        // a command, or trouble on the bus
    bus_off,        // the adapter's controller gave up, and starts anew when the device is opened again
    nothing,        // that anybody waits for
    between_lines,  // not even a line: the second half of a line end
    malformed,
  };

  // A line ends with either of the two.
  TextBus(SerialPort port, std::int64_t reply_wait_ns, char end, char other_end)
      : port_(std::move(port)), reply_wait_ns_(reply_wait_ns), end_(end), other_end_(other_end) {}

  // The line that sends a frame, with its end; 0: it cannot be said or does not fit.
  virtual std::size_t format(const Frame& frame, std::span<char> out) LITHE_RT = 0;
  // `line` comes with its end.
  virtual Said parse(std::string_view line, Frame& frame) LITHE_RT = 0;
  // What the adapter must be told before the first frame.
  // Contract: never in the tick
  virtual std::string greeting() const { return ""; }
  // The adapter is new: what is known of the old one no longer holds.
  virtual void forget() LITHE_RT {}

  // For a last word at the end, when there is nobody else any more. Not said behind half a line: the two together would
  // be a command.
  // Contract: never in the tick
  void say(std::string_view text);

  // In this exchange send() refuses.
  // Contract: between begin() and the first send()
  void mute(bool mute) LITHE_RT { mute_ = mute; }
  // A line that is no frame, with its end; it leaves with the commands. Passed over when there is no room.
  void add(std::string_view line) LITHE_RT;
  const std::string& path() const { return port_.path(); }
  const SerialIdentity& adapter() const LITHE_RT { return port_.identity(); }

 private:
  static constexpr std::size_t kLongestLine = 256;
  static constexpr std::size_t kOutbound = 16384;  // about 100 of the longest commands
  static constexpr std::size_t kInbound = 4096;    // as much as a terminal holds

  Result<> connect();
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

  std::size_t out_from_ = 0;  // what has not left yet
  std::size_t out_to_ = 0;
  bool half_gone_ = false;  // the first line of it
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
