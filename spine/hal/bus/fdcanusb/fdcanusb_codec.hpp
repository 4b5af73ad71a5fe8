// SPDX-License-Identifier: Apache-2.0
// The text lines between a host and an fdcanusb adapter, both sides. Pure: text in, frames out; no I/O, no state.
//
//   host     can send|std|ext ID DATA [FLAGS]    ID: hex below 2^29; DATA: hex, at least one byte
//            can on | off | status | config      conf get|set|enumerate|load|write|default ...
//   adapter  rcv ID DATA E|e B|b F|f R|r xNN     OK    ERR text    or what was asked for
// Flags of a command have no spaces between them: B|b faster data phase, F|f CAN FD, R|r remote; a capital means yes; a
// missing flag is as the adapter is configured. Flags of a received frame stand alone; unknown ones are ignored. `send`
// makes the frame extended when its id needs more than 11 bits. A line may end in " *XX": a CRC-8 of all before the
// asterisk. After the first valid checksum a side demands one on every line.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::fdcanusb {

// Longest line without its end. A line with a frame has at most 157 bytes; longer lines are refused.
inline constexpr std::size_t kLongestLine = 256;

// Polynomial 0x97, start 0, highest bit first.
std::uint8_t crc8(std::string_view text) LITHE_RT;

enum class Sum : std::uint8_t { absent, right, wrong };

// Removes a checksum (valid or not) and the spaces before it from the end of `line`.
Sum strip_sum(std::string_view& line) LITHE_RT;

// Appends " *XX" to the `size` bytes of `out`. The new length; 0 when it does not fit.
std::size_t append_sum(std::span<char> out, std::size_t size) LITHE_RT;

// ---- The host's side

// The command that sends a frame, with its newline. Returns the length; 0: not possible (no data, an invalid id or
// size, a classic frame beyond 8 bytes), or it does not fit (154 bytes are always enough).
std::size_t format_send(const Frame& frame, bool checksum, std::span<char> out) LITHE_RT;

struct Line {
  enum class Kind : std::uint8_t {
    received,  // a frame
    ok,        // the adapter accepted a command
    error,     // it refused one; `text` is the reason
    other,     // anything else: the answer to a question, a remote frame, a line of another program
  };
  Kind kind = Kind::other;
  Sum sum = Sum::absent;
  Frame frame;
  std::string_view text;  // of error: what follows "ERR "; of other: all; lies in the line that was parsed
};

// Parses one line of an adapter, without its end. False: wrong or missing checksum, invalid frame, line too long; `out`
// is then undefined.
bool parse_line(std::string_view line, bool want_checksum, Line& out) LITHE_RT;

// ---- The adapter's side

// Defaults for flags that a command leaves out.
struct Defaults {
  bool fd = true;
  bool brs = true;
};

struct Request {
  enum class Kind : std::uint8_t { send, remote, on, off, status, config, conf, nothing };
  Kind kind = Kind::nothing;  // remote: a request without data, which no device here answers
  Frame frame;                // of send
  std::string_view text;      // of conf: what follows it; lies in the line that was parsed
};

// Parses one line of a host, without end and checksum. Null on success; else the text after "ERR ", as in the adapters'
// firmware. An empty line is valid and does nothing.
const char* parse_request(std::string_view line, const Defaults& defaults, Request& out) LITHE_RT;

// Formats a received frame, without line end or checksum. Returns the length; 0: does not fit (153 bytes are always
// enough).
std::size_t format_received(const Frame& frame, std::span<char> out) LITHE_RT;

}  // namespace lithe::hal::fdcanusb
