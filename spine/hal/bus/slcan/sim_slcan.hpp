// SPDX-License-Identifier: Apache-2.0
// The adapter's side of slcan: commands in, frames to the simulated devices, lines out.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "spine/hal/bus/serial/sim_adapter.hpp"
#include "spine/hal/bus/slcan/slcan_codec.hpp"

namespace lithe::hal::sim {

enum class SlcanManners : std::uint8_t {
  lawicel,  // every command is answered: done, refused, sent
  silent,   // sends only frames and answers to queries, like cheap adapters
};

// As LAWICEL's manual says: closed from the start; bit rates and time stamps are set while it is closed, it opens when
// it knows a bit rate, and only then frames pass. CAN FD passes when a data bit rate was set as well. In listen-only
// mode nothing is sent. A time stamp counts milliseconds and starts over every minute. Bus-off is reported once, and
// lasts until the channel is closed and opened.
// Contract: as SimAdapter
class SimSlcan final : public SimAdapter {
 public:
  explicit SimSlcan(SlcanManners manners = SlcanManners::lawicel)
      : SimAdapter(slcan::kLongestLine), manners_(manners) {}

  void idle(std::int64_t now_ns, std::string& out) override;

  bool is_open() const { return channel_ != Channel::closed; }

 private:
  enum class Channel : std::uint8_t { closed, open, listening };

  bool ends_line(char c) const override { return c == slcan::kDone; }
  void serve(std::string_view line, std::int64_t now_ns, std::string& out) override;
  void refuse(std::string& out) const override;
  void restart() override;
  bool handle(slcan::Request request);
  bool open(Channel channel);
  bool may_send(const Frame& frame) const { return channel_ == Channel::open && (fd_ || !frame.fd); }
  void pass_on(std::int64_t now_ns, std::string& out);
  void say(std::string_view manners, std::string& out) const;

  SlcanManners manners_;
  Channel channel_ = Channel::closed;
  bool has_bitrate_ = false;
  bool fd_ = false;
  bool stamps_ = false;
  bool confirmed_off_ = false;
};

}  // namespace lithe::hal::sim
