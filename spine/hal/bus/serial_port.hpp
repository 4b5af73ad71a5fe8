// SPDX-License-Identifier: Apache-2.0
// A serial device or pseudo terminal as a plain stream of bytes that never waits.
#pragma once

#include <span>
#include <string>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/descriptor.hpp"

namespace lithe::hal {

// Contract: read, write RT, never wait, one thread · open, close never in the tick, nor while another thread reads
class SerialPort {
 public:
  explicit SerialPort(std::string path) : path_(std::move(path)) {}

  // Opens, or closes and opens again: raw, eight bits, no flow control, 921600 baud where there are bauds, without the
  // driver's own delays, not the terminal that may end this process, locked against other programs that ask. What the
  // other end said before is forgotten. The error says what to do.
  Result<> open();
  void close() { descriptor_.close(); }

  // An error means that the other end is gone.
  Moved read(std::span<char> to) LITHE_RT { return descriptor_.read(std::as_writable_bytes(to)); }
  Moved write(std::span<const char> from) LITHE_RT { return descriptor_.write(std::as_bytes(from)); }

  const std::string& path() const { return path_; }

 private:
  std::string path_;
  Descriptor descriptor_;
};

}  // namespace lithe::hal
