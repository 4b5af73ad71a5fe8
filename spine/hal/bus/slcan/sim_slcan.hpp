// SPDX-License-Identifier: Apache-2.0
// The adapter's side of slcan: commands in, frames to the simulated devices, lines out.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
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
  explicit SimSlcan(SlcanManners manners = SlcanManners::lawicel) : manners_(manners) {}

  void feed(std::span<const char> bytes, std::int64_t now_ns, std::string& out) override;
  void idle(std::int64_t now_ns, std::string& out) override;
  void reset() override;

  bool is_open() const { return channel_ != Channel::closed; }

 private:
  enum class Channel : std::uint8_t { closed, open, listening };

  void serve(std::string_view line, std::int64_t now_ns, std::string& out);
  bool obey(slcan::Request request);
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
  std::array<char, slcan::kLongestLine> line_{};
  std::size_t length_ = 0;
  bool too_long_ = false;
};

}  // namespace lithe::hal::sim
