// SPDX-License-Identifier: Apache-2.0
// A serial device or pseudo terminal as a non-blocking byte stream.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/core/descriptor.hpp"

namespace lithe::hal {

// Identity of the hardware behind a serial device: after replugging, the same path may lead to another one.
struct SerialIdentity {
  // Unique name. On USB: vendor, product, and serial number or port; otherwise its location. Empty: unknown (pseudo
  // terminal).
  std::string who;
  bool fdcanusb = false;  // by the USB ids of mjbots' adapters
};

// Of an open device, from the kernel's information below `sys`. Empty = no information.
// Contract: never in the tick
SerialIdentity identify(int fd, const std::string& sys = "/sys");

inline constexpr std::uint32_t kUsualBaud = 921'600;

// Contract: read, write RT, never wait, one thread · open, close never in the tick, nor while another thread reads
class SerialPort {
 public:
  // `sys`: the kernel's device information.
  explicit SerialPort(std::string path, std::uint32_t baud = kUsualBaud, std::string sys = "/sys")
      : path_(std::move(path)), baud_(baud), sys_(std::move(sys)) {}

  // Opens, or closes and opens again: raw, eight bits, no flow control, without the driver's own delays, not the
  // terminal that may end this process, locked against other programs that ask. Old input is discarded. Different
  // hardware than at the first opening is refused: drives repeat their ids on each bus, so nothing else would detect
  // it. The error names the next step.
  Result<> open();
  void close() { descriptor_.close(); }

  // An error means that the other end is closed.
  Moved read(std::span<char> to) LITHE_RT { return descriptor_.read(std::as_writable_bytes(to)); }
  Moved write(std::span<const char> from) LITHE_RT { return descriptor_.write(std::as_bytes(from)); }

  const std::string& path() const { return path_; }
  // Identity of the device opened last.
  const SerialIdentity& identity() const LITHE_RT { return identity_; }

 private:
  std::string path_;
  std::uint32_t baud_;
  std::string sys_;
  SerialIdentity identity_;
  Descriptor descriptor_;
};

}  // namespace lithe::hal
