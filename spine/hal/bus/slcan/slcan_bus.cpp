// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/slcan/slcan_bus.hpp"

#include <utility>

#include "spine/hal/bus/slcan/slcan_codec.hpp"

namespace lithe::hal {

SlcanBus::SlcanBus(const SlcanParams& params, std::string greeting)
    : TextBus(SerialPort(params.path, params.baud), params.reply_wait_ns, slcan::kDone, slcan::kRefused),
      greeting_(std::move(greeting)),
      fd_(params.data_bitrate > 0) {}

Result<std::unique_ptr<SlcanBus>> SlcanBus::open(const SlcanParams& params) {
  const char rate = slcan::bitrate_digit(params.bitrate);
  const char data_rate = slcan::data_bitrate_digit(params.data_bitrate);
  if (rate == '\0') {
    return Error{params.path + ": slcan has no bit rate of " + std::to_string(params.bitrate) +
                 "; use 10000, 20000, 50000, 100000, 125000, 250000, 500000, 800000 or 1000000"};
  }
  if (params.data_bitrate != 0 && data_rate == '\0') {
    return Error{params.path + ": slcan has no data bit rate of " + std::to_string(params.data_bitrate) +
                 "; use 2000000, 5000000, or 0 for classic CAN"};
  }
  // An open channel keeps its bit rate, so it is closed first. First a line that cannot complete a partial command of
  // an earlier program: V is not a hex digit, C is. Not an empty line: some adapters repeat the last command on it.
  std::string greeting = std::string("V\rC\rS") + rate + "\r";
  if (params.data_bitrate != 0) greeting += std::string("Y") + data_rate + "\r";
  std::unique_ptr<SlcanBus> bus(new SlcanBus(params, greeting + "O\r"));
  if (const Result<> opened = bus->TextBus::open(); !opened) return opened.error();
  return bus;
}

std::size_t SlcanBus::format(const Frame& frame, std::span<char> out) LITHE_RT {
  return frame.fd && !fd_ ? 0 : slcan::format_frame(frame, out);
}

TextBus::Said SlcanBus::parse(std::string_view line, Frame& frame) LITHE_RT {
  // By slcan::Answer: frame, done, sent, refused, error, bus_off, other, malformed.
  constexpr Said kSaid[] = {Said::frame,   Said::acknowledged, Said::acknowledged, Said::refused,
                            Said::refused, Said::bus_off,      Said::nothing,      Said::malformed};
  return kSaid[static_cast<std::size_t>(slcan::parse_answer(line, frame))];
}

}  // namespace lithe::hal
