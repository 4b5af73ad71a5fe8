// SPDX-License-Identifier: Apache-2.0
// A CAN bus behind an slcan adapter (LAWICEL protocol); CAN FD as in the CANable 2.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "spine/core/result.hpp"
#include "spine/hal/bus/serial/text_bus.hpp"

namespace lithe::hal {

struct SlcanParams {
  std::string path;
  std::uint32_t bitrate = 1'000'000;
  std::uint32_t data_bitrate = 0;  // 2'000'000 or 5'000'000; 0 = classic CAN only
  std::int64_t reply_wait_ns = 2'000'000;
  std::uint32_t baud = kUsualBaud;  // where there are bauds: USB has none
};

// Adapters as in LAWICEL's manual refuse to close a closed channel: this counts as one of statistics().errors at each
// opening.
// Contract: as TextBus
class SlcanBus final : public TextBus {
 public:
  // Sets the adapter's bit rates and opens its channel. The error names the next step.
  static Result<std::unique_ptr<SlcanBus>> open(const SlcanParams& params);
  // Closes the channel, so that the adapter does not fill a buffer that is not read.
  ~SlcanBus() override { say("C\r"); }

 protected:
  std::size_t format(const Frame& frame, std::span<char> out) LITHE_RT override;
  Said parse(std::string_view line, Frame& frame) LITHE_RT override;
  std::string greeting() const override { return greeting_; }

 private:
  SlcanBus(const SlcanParams& params, std::string greeting);

  std::string greeting_;
  bool fd_;
};

}  // namespace lithe::hal
