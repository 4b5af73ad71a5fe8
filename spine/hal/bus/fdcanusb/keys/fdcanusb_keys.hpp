// SPDX-License-Identifier: Apache-2.0
// Keys of a [[bus]] that only an fdcanusb has.
#pragma once

#include <cstdint>

namespace lithe::robot {
class Reader;
}

namespace lithe::hal {

enum class Checksums : std::uint8_t {
  off,        // never sent
  on,         // sent with every line, and demanded of every answer
  automatic,  // as `on`, after the adapter has sent or demanded one
  by_device,  // as `automatic` for an fdcanusb (USB has checksums), else as `on`
};

}  // namespace lithe::hal

namespace lithe::hal::fdcanusb {

struct Keys {
  Checksums checksums = Checksums::by_device;  // of the lines to the adapter
};

void read_keys(robot::Reader& in, Keys& keys);

}  // namespace lithe::hal::fdcanusb
