// SPDX-License-Identifier: Apache-2.0
// The text between a host and an slcan adapter (LAWICEL's protocol), both sides. Pure: text in, frames out.
//
//   host     tIIILDD..  TIIIIIIIILDD..  data       rIIIL  RIIIIIIIIL  remote      small letter: 11 bits, capital: 29
//            d.. D..  CAN FD     b.. B..  with the faster data phase             (the CANable 2's letters)
//            S0 to S8, sXXYY bit rate   Y2 Y5 of the data phase   O open   L listen only   C close
//            V version   N serial number   F status   Z0 Z1 time stamps          each ends in \r
//   adapter  the same letters for what it received, with four digits of time stamp [ms] behind it after Z1
//            \r done   \a refused   z\r Z\r sent      many adapters never say any of these
//            sa sw sp sb state of its controller: active, warning, passive, bus-off; e.. bus errors
// I: id, L: length (one hex digit, of FD the code of a length), D: data; hex.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::slcan {

inline constexpr char kDone = '\r';
inline constexpr char kRefused = '\a';

// With its end: B, 8 digits, length, 128 digits of data, 4 of time stamp.
inline constexpr std::size_t kLongestLine = 143;

// The line that sends or reports a frame, with its \r. Returns the length; 0: not a valid CAN frame, or it does not fit
// (kLongestLine is always enough).
std::size_t format_frame(const Frame& frame, std::span<char> out) LITHE_RT;

// ---- The host's side

enum class Answer : std::uint8_t {
  frame,      // received
  done,       // a command
  sent,       // a frame
  refused,    // a command or a frame
  error,      // of the bus, or a controller in an error state
  bus_off,    // bus-off: nothing is sent or received until the channel is opened again
  other,      // recovered controller, remote frames, versions, numbers: no answer to a command
  malformed,  // not a valid line
};

// Parses one line of an adapter, with its end \r or \a. `frame` is changed by Answer::frame only.
Answer parse_answer(std::string_view line, Frame& frame) LITHE_RT;

// The digit behind S; '\0' when slcan has no such bit rate. S7 is 800 kbit/s with LAWICEL and 750 with others.
char bitrate_digit(std::uint32_t bitrate) LITHE_RT;
// The digit behind Y, likewise.
char data_bitrate_digit(std::uint32_t bitrate) LITHE_RT;

// ---- The adapter's side

enum class Request : std::uint8_t {
  send,
  remote,
  bitrate,
  data_bitrate,
  open,
  listen,
  close,
  version,
  serial,
  status,
  stamps_off,
  stamps_on,
  other,      // A0 A1 M0 M1 X.. Q.. m.. M..: accepted, without effect
  malformed,  // to be refused
};

// Parses one line of a host, without its end. `frame` is changed by Request::send only.
Request parse_request(std::string_view line, Frame& frame) LITHE_RT;

}  // namespace lithe::hal::slcan
