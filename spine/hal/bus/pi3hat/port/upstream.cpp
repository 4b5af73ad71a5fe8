// SPDX-License-Identifier: Apache-2.0
// The maker's library behind our interface. Built on a Raspberry Pi only, with -DLITHE_PI3HAT=ON; the only file here
// with exceptions; they are caught here.
#include <mjbots/pi3hat/pi3hat.h>

#include <algorithm>
#include <array>
#include <exception>
#include <string>
#include <utility>

#include "spine/hal/bus/pi3hat/pi3hat_port.hpp"

namespace lithe::hal {
namespace {

namespace maker = mjbots::pi3hat;

maker::Pi3Hat::Configuration configuration(const Pi3hatParams& params) {
  maker::Pi3Hat::Configuration configuration;
  for (std::size_t i = 0; i < params.lines.size(); ++i) {
    const Pi3hatLine& line = params.lines[i];
    maker::Pi3Hat::CanConfiguration& can = configuration.can[i];
    can.bus_monitor = !line.used;
    can.slow_bitrate = static_cast<int>(line.bitrate);
    can.fast_bitrate = static_cast<int>(std::max(line.bitrate, line.data_bitrate));
    can.fdcan_frame = can.bitrate_switch = line.data_bitrate > 0;
  }
  return configuration;
}

// The expected answer size, from which the maker's library computes how long to wait; that of a moteus for our queries.
constexpr std::uint8_t kAnswerBytes = 24;

class UpstreamPort final : public Pi3hatPort {
 public:
  explicit UpstreamPort(const Pi3hatParams& params) : board_(configuration(params)), params_(params) {}

  Pi3hatOutcome cycle(const Pi3hatOrder& order, std::span<Pi3hatFrame> received, Pi3hatAttitude& attitude)
      LITHE_RT override {
    const std::size_t sent = std::min(order.send.size(), out_.size());
    bool awaits = false;
    for (std::size_t i = 0; i < sent; ++i) {
      const Pi3hatFrame& from = order.send[i];
      maker::CanFrame& to = out_[i];
      to.id = from.frame.id;
      to.size = from.frame.size;
      to.bus = static_cast<int>(from.connector);
      to.expect_reply = from.answered;
      to.expected_reply_size = from.answered ? kAnswerBytes : 0;
      std::copy_n(from.frame.data.begin(), from.frame.payload().size(), to.data);
      awaits = awaits || from.answered;
    }
    maker::Attitude measured;
    maker::Pi3Hat::Input input;
    input.tx_can = {out_.data(), sent};
    input.rx_can = {in_.data(), std::min(in_.size(), received.size())};
    // Without expected answers there is no wait. The wait is per device, so it does not grow with their number.
    const auto wait_ns = static_cast<std::uint32_t>(awaits ? order.longest_wait_ns : 0);
    input.min_tx_wait_ns = std::min(input.min_tx_wait_ns, wait_ns);
    input.rx_baseline_wait_ns = wait_ns;
    input.force_can_check = order.listen;
    input.request_attitude = order.attitude;
    input.attitude = &measured;
    maker::Pi3Hat::Output output;
    LITHE_RT_EXEMPT("SPI through mapped registers: busy, bounded by its own waits; its lists grow in the first cycles",
                    { output = board_.Cycle(input); });
    const std::size_t count = std::min<std::size_t>(output.rx_can_size, received.size());
    for (std::size_t i = 0; i < count; ++i) take(in_[i], received[i]);
    attitude.attitude = {measured.attitude.w, measured.attitude.x, measured.attitude.y, measured.attitude.z};
    attitude.rate_dps = {measured.rate_dps.x, measured.rate_dps.y, measured.rate_dps.z};
    attitude.acceleration_mps2 = {measured.accel_mps2.x, measured.accel_mps2.y, measured.accel_mps2.z};
    return {count, order.attitude && output.attitude_present, output.error};
  }

  // True when the board's firmware survives frames without acknowledgement (a drive is off).
  bool sound() const { return sound_; }

 private:
  void take(const maker::CanFrame& from, Pi3hatFrame& to) const LITHE_RT {
    to = Pi3hatFrame{};
    to.connector = static_cast<std::uint32_t>(from.bus);
    to.frame.id = from.id;
    to.frame.extended = from.id > kLargestStandardId;
    to.frame.size = std::min<std::uint8_t>(from.size, kMaxPayload);
    const bool known = from.bus >= 1 && from.bus <= static_cast<int>(kPi3hatConnectors);
    to.frame.fd = known && params_.lines[static_cast<std::size_t>(from.bus - 1)].data_bitrate > 0;
    to.frame.brs = to.frame.fd;
    std::copy_n(from.data, to.frame.size, to.frame.data.begin());
  }

  maker::Pi3Hat board_;
  const bool sound_ = board_.device_info().can_unknown_address_safe;
  Pi3hatParams params_;
  std::array<maker::CanFrame, 128> out_;
  std::array<maker::CanFrame, 160> in_;
};

}  // namespace

Result<std::unique_ptr<Pi3hatPort>> open_pi3hat_port(const Pi3hatParams& params) {
  try {
    auto port = std::make_unique<UpstreamPort>(params);
    if (!port->sound()) {
      return Error{
          "the firmware of this pi3hat is too old: it freezes when a frame is not acknowledged, as when a drive is "
          "off; update it as its maker says (https://github.com/mjbots/pi3hat)"};
    }
    return std::unique_ptr<Pi3hatPort>(std::move(port));
  } catch (const std::exception& wrong) {
    return Error{std::string("the pi3hat cannot be opened: ") + wrong.what() +
                 "; it takes root (sudo) and a Raspberry Pi 3 or 4 with the board on it, used by no other program"};
  }
}

}  // namespace lithe::hal
