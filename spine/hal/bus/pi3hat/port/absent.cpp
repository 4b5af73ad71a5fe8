// SPDX-License-Identifier: Apache-2.0
// For builds without the maker's library (LITHE_PI3HAT=OFF).
#include "spine/hal/bus/pi3hat/pi3hat_port.hpp"

namespace lithe::hal {

Result<std::unique_ptr<Pi3hatPort>> open_pi3hat_port(const Pi3hatParams&) {
  return Error{
      "this build knows no pi3hat. On the Raspberry Pi: git clone https://github.com/mjbots/pi3hat (1.0.0 or newer; "
      "nothing of it needs to be built), then build LITHE with: cmake --preset release -DLITHE_PI3HAT=ON "
      "-DLITHE_PI3HAT_DIR=<that folder> && cmake --build --preset release (docs/hardware.md)"};
}

}  // namespace lithe::hal
