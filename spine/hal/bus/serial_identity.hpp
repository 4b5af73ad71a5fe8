// SPDX-License-Identifier: Apache-2.0
// Which piece of hardware is behind a serial device: its path may name another one after the next plug.
#pragma once

#include <string>

namespace lithe::hal {

struct SerialIdentity {
  // Tells it from others. On USB: vendor, product, and serial number or socket; else its place. Empty: a pseudo
  // terminal, of which the kernel tells nothing.
  std::string who;
  bool fdcanusb = false;  // by the numbers of mjbots' adapters on USB
};

// Of an open device, as the kernel tells it under `sys`. Empty where it tells nothing.
// Contract: never in the tick
SerialIdentity identify(int fd, const std::string& sys = "/sys");

}  // namespace lithe::hal
