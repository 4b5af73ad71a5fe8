// SPDX-License-Identifier: Apache-2.0
// Identity of the hardware behind a serial device: after replugging, the same path may lead to another one.
#pragma once

#include <string>

namespace lithe::hal {

struct SerialIdentity {
  // Unique name. On USB: vendor, product, and serial number or port; otherwise its location. Empty: unknown (pseudo
  // terminal).
  std::string who;
  bool fdcanusb = false;  // by the USB ids of mjbots' adapters
};

// Of an open device, from the kernel's information below `sys`. Empty = no information.
// Contract: never in the tick
SerialIdentity identify(int fd, const std::string& sys = "/sys");

}  // namespace lithe::hal
