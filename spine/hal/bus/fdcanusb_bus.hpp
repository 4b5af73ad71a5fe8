// SPDX-License-Identifier: Apache-2.0
// A CAN FD bus behind an fdcanusb, or whatever else speaks its lines: a moteus on a UART, a simulated robot.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "spine/core/result.hpp"
#include "spine/hal/bus/text_bus.hpp"

namespace lithe::hal {

enum class Checksums : std::uint8_t {
  off,        // never sent
  on,         // sent with every line, and demanded of every answer
  automatic,  // as on, from the moment the adapter sends or asks for one
};

struct FdcanusbParams {
  std::string path;
  Checksums checksums = Checksums::automatic;
  std::int64_t reply_wait_ns = 2'000'000;
};

// The bit rates are the adapter's own, kept in its memory.
// Contract: as TextBus
class FdcanusbBus final : public TextBus {
 public:
  // The error says what to do.
  static Result<std::unique_ptr<FdcanusbBus>> open(const FdcanusbParams& params);

 protected:
  std::size_t format(const Frame& frame, std::span<char> out) LITHE_RT override;
  Said parse(std::string_view line, Frame& frame) LITHE_RT override;
  void forget() LITHE_RT override { with_sums_ = checksums_ == Checksums::on; }

 private:
  explicit FdcanusbBus(const FdcanusbParams& params);

  Checksums checksums_;
  bool with_sums_;
};

}  // namespace lithe::hal
