// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb_bus.hpp"

#include <span>
#include <string_view>

#include "spine/hal/bus/fdcanusb_codec.hpp"

namespace lithe::hal {

FdcanusbBus::FdcanusbBus(const FdcanusbParams& params)
    : TextBus(params.path, params.reply_wait_ns, '\n', '\r'),
      checksums_(params.checksums),
      with_sums_(params.checksums == Checksums::on) {}

// It is told nothing: it is on after power-up. Not even an empty line, to end what a program before us may have left
// half said: half a command, once ended, is a command, and might move a motor.
Result<std::unique_ptr<FdcanusbBus>> FdcanusbBus::open(const FdcanusbParams& params) {
  std::unique_ptr<FdcanusbBus> bus(new FdcanusbBus(params));
  if (const Result<> opened = bus->TextBus::open(); !opened) return opened.error();
  return bus;
}

std::size_t FdcanusbBus::format(const Frame& frame, std::span<char> out) LITHE_RT {
  return fdcanusb::format_send(frame, with_sums_, out);
}

TextBus::Said FdcanusbBus::parse(std::string_view line, Frame& frame) LITHE_RT {
  line.remove_suffix(1);
  if (line.empty()) return Said::between_lines;
  fdcanusb::Line said;
  if (!fdcanusb::parse_line(line, with_sums_, said)) return Said::malformed;
  const bool demanded =
      said.kind == fdcanusb::Line::Kind::error && said.text.find("checksum") != std::string_view::npos;
  if (checksums_ == Checksums::automatic && (demanded || fdcanusb::strip_sum(line) == fdcanusb::Sum::right)) {
    with_sums_ = true;
  }
  switch (said.kind) {
    case fdcanusb::Line::Kind::received:
      frame = said.frame;
      return Said::frame;
    case fdcanusb::Line::Kind::ok:
      return Said::acknowledged;
    case fdcanusb::Line::Kind::error:
      return Said::refused;
    case fdcanusb::Line::Kind::other:
      break;
  }
  return Said::nothing;
}

}  // namespace lithe::hal
