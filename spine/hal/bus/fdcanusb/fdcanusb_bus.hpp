// SPDX-License-Identifier: Apache-2.0
// A CAN FD bus behind an fdcanusb, or whatever else speaks its lines: a moteus on a UART, a simulated robot.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/hal/bus/serial/text_bus.hpp"

namespace lithe::hal {

enum class Checksums : std::uint8_t {
  off,        // never sent
  on,         // sent with every line, and demanded of every answer
  automatic,  // as on, from the moment the adapter sends or asks for one
  by_device,  // as on, but automatic with an fdcanusb: USB checks for itself, a drive on a UART waits for us to begin
};

struct FdcanusbParams {
  std::string path;
  Checksums checksums = Checksums::by_device;
  std::int64_t reply_wait_ns = 2'000'000;
  std::uint32_t baud = kUsualBaud;  // where there are bauds: USB has none
  std::string sys = "/sys";         // where the kernel tells about devices
};

// The bit rates are the adapter's own, kept in its memory. When it is opened it is told to be on the bus, and to come
// back after a bus-off, which its firmware otherwise does not.
// When half a second and 256 frames have brought no answer, because the drives have no power or the bus no wires, only
// one exchange in 0.6 s is sent, with a question for the adapter's state: it keeps up to 35 frames that nobody
// acknowledges, and would send them, old as they are, when the drives return. While it says that it is bus-off nothing
// is sent at all.
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
  std::uint64_t heard_ = 0;           // frames, when the last one came
  std::uint64_t sent_ = 0;            // frames until then
  std::int64_t heard_ns_ = 0;         // in which exchange that was
  std::int64_t asked_ns_ = 0;         // the last one that was sent into silence
  std::atomic<bool> bus_off_{false};  // relaxed throughout: it is the exchange's, why_down() only tells it
};

}  // namespace lithe::hal
