// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia401/keys/cia401_keys.hpp"

#include <fmt/format.h>

#include "spine/robot/read/reader.hpp"

namespace lithe::hal::cia401 {

void read_keys(robot::Reader& in, Keys& keys, double watchdog_s) {
  in.integer("digital_inputs", keys.inputs.digital, {0, static_cast<double>(kDigital)});
  in.integer("analog_inputs", keys.inputs.analog, {0, static_cast<double>(kAnalog)});
  in.number("send_every_s", keys.send_every_s, {0.001, 10.0});
  if (keys.inputs.digital + keys.inputs.analog == 0)
    in.complain("digital_inputs", "the device has no inputs; give digital_inputs or analog_inputs");
  if (2 * keys.send_every_s > watchdog_s) {
    in.complain("send_every_s", fmt::format("{:g} s are more than half of watchdog_s: one lost frame would make its "
                                            "values invalid; give at most {:g}",
                                            keys.send_every_s, watchdog_s / 2));
  }
}

}  // namespace lithe::hal::cia401
