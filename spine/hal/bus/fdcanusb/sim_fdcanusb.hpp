// SPDX-License-Identifier: Apache-2.0
// The adapter's side of an fdcanusb: lines in, frames to the simulated devices, lines out.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"
#include "spine/hal/bus/serial/sim_adapter.hpp"

namespace lithe::hal::sim {

// As the firmware does: on from the start; OK before what the devices answer; a query is answered by one line without
// OK; refusals use the firmware's texts. After the first valid checksum it demands and sends checksums, like a drive's
// serial port. Bus-off is reported only on a query, and lasts until the bus is switched off and on, or ends by itself
// with can.autorecover. Lines longer than any command are ignored.
// Contract: as SimAdapter
class SimFdcanusb final : public SimAdapter {
 public:
  static constexpr std::size_t kSettings = 17;
  using Settings = std::array<double, kSettings>;

  SimFdcanusb();

  void idle(std::int64_t now_ns, std::string& out) override;

 private:
  bool ends_line(char c) const override { return c == '\n' || c == '\r'; }
  void serve(std::string_view line, std::int64_t now_ns, std::string& out) override;
  void restart() override;
  void handle(const fdcanusb::Request& request, std::int64_t now_ns, std::string& out);
  void configure(std::string_view words, std::string& out);
  void switch_bus(bool on, std::string& out);
  void say(std::string_view text, std::string& out) const;
  void pass_on(std::string& out);

  bool sums_ = false;
  bool on_ = true;
  Settings settings_;
  Settings stored_;
};

}  // namespace lithe::hal::sim
