// SPDX-License-Identifier: Apache-2.0
// A CAN FD bus behind an fdcanusb, or behind another device with the same protocol: a moteus on a UART, a simulated
// robot.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/hal/bus/fdcanusb/keys/fdcanusb_keys.hpp"
#include "spine/hal/bus/serial/text_bus.hpp"

namespace lithe::hal {

struct FdcanusbParams {
  std::string path;
  Checksums checksums = Checksums::by_device;
  std::int64_t reply_wait_ns = 2'000'000;
  std::uint32_t baud = kUsualBaud;  // for UARTs; USB has no baud rate
  std::string sys = "/sys";         // the kernel's device information
};

// The adapter has its bit rates in its own memory. On opening, it is switched on, and automatic recovery from bus-off
// is enabled, which is off in its firmware. When 256 frames and half a second have brought no answer (drives without
// power, broken wires), only one exchange per 0.6 s is sent, with a query of the adapter's state: it keeps up to 35
// unacknowledged frames, and would send these old frames when the drives return. While it reports bus-off nothing is
// sent.
// Contract: as TextBus
class FdcanusbBus final : public TextBus {
 public:
  // The error says what to do.
  static Result<std::unique_ptr<FdcanusbBus>> open(const FdcanusbParams& params);

  void begin(std::int64_t now_ns) LITHE_RT override;
  std::string why_down() const override;

 protected:
  std::size_t format(const Frame& frame, std::span<char> out) LITHE_RT override;
  Said parse(std::string_view line, Frame& frame) LITHE_RT override;
  std::string greeting() const override;
  void forget() LITHE_RT override;

 private:
  explicit FdcanusbBus(const FdcanusbParams& params);

  bool begins_with_sums() const LITHE_RT;
  bool exchange_is_due(std::int64_t now_ns) LITHE_RT;
  void note_state(std::string_view status) LITHE_RT;

  Checksums checksums_;
  bool with_sums_ = false;
  bool begun_ = false;
  std::uint64_t heard_ = 0;           // frames received so far
  std::uint64_t sent_ = 0;            // frames sent at that time
  std::int64_t heard_ns_ = 0;         // time of that exchange
  std::int64_t asked_ns_ = 0;         // the last query without an answer
  std::atomic<bool> bus_off_{false};  // relaxed: written by the exchange, only reported by why_down()
};

}  // namespace lithe::hal
