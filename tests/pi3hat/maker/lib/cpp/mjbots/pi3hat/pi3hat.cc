// SPDX-License-Identifier: Apache-2.0
#include "pi3hat.h"

#include <stdexcept>

namespace mjbots::pi3hat {

Notes& notes() {
  static Notes all;
  return all;
}

Pi3Hat::Pi3Hat(const Configuration& configuration) {
  if (notes().absent) throw std::runtime_error("no board");
  notes().configuration = configuration;
}

Pi3Hat::Output Pi3Hat::Cycle(const Input& input) {
  Notes& now = notes();
  now.input = input;
  now.sent.clear();
  for (std::size_t i = 0; i < input.tx_can.size(); ++i) now.sent.push_back(input.tx_can[i]);
  now.room = input.rx_can.size();
  Output output;
  for (; output.rx_can_size < now.arrives.size() && output.rx_can_size < now.room; ++output.rx_can_size) {
    input.rx_can[output.rx_can_size] = now.arrives[output.rx_can_size];
  }
  return output;
}

Pi3Hat::DeviceInfo Pi3Hat::device_info() { return {notes().can_unknown_address_safe}; }

}  // namespace mjbots::pi3hat
