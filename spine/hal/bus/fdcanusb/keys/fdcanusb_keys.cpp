// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb/keys/fdcanusb_keys.hpp"

#include "spine/robot/read/reader.hpp"

namespace lithe::hal::fdcanusb {

void read_keys(robot::Reader& in, Keys& keys) {
  in.choice<Checksums>("checksums", keys.checksums,
                       {{"auto", Checksums::by_device}, {"on", Checksums::on}, {"off", Checksums::off}});
}

}  // namespace lithe::hal::fdcanusb
