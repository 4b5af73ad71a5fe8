// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/slcan/sim_slcan.hpp"

#include <array>

#include "spine/hal/bus/serial/hex.hpp"

namespace lithe::hal::sim {

using slcan::Request;

namespace {

constexpr std::string_view kDone = "\r";
constexpr std::string_view kRefused = "\a";
constexpr std::int64_t kStampPeriodMs = 60'000;
constexpr std::int64_t kNsPerMs = 1'000'000;

// An answer to a question, or nothing.
std::string_view answer_to(Request request, bool is_open) {
  switch (request) {
    case Request::version:
      return "V1013\r";
    case Request::serial:
      return "NLTHE\r";
    case Request::status:
      return is_open ? "F00\r" : "";
    default:
      return "";
  }
}

}  // namespace

void SimSlcan::restart() {
  channel_ = Channel::closed;
  has_bitrate_ = fd_ = stamps_ = confirmed_off_ = false;
}

void SimSlcan::idle(std::int64_t now_ns, std::string& out) {
  time_to_bus(now_ns);
  if (bus_off() && is_open() && !confirmed_off_) {
    out += "sb255000\r";
    confirmed_off_ = true;
  }
  pass_on(now_ns, out);
}

void SimSlcan::serve(std::string_view line, std::int64_t now_ns, std::string& out) {
  Frame frame;
  const Request request = slcan::parse_request(line, frame);
  if (const std::string_view answer = answer_to(request, is_open()); !answer.empty()) {
    out += answer;
  } else if (request != Request::send && request != Request::remote) {
    say(handle(request) ? kDone : kRefused, out);
  } else if (!may_send(frame)) {
    say(kRefused, out);
  } else {
    say(line.front() >= 'a' ? "z\r" : "Z\r", out);
    if (request == Request::remote) return;  // no simulated device answers one
    to_bus(frame, now_ns);
    pass_on(now_ns, out);
  }
}

// False: refused.
bool SimSlcan::handle(Request request) {
  switch (request) {
    case Request::open:
      return open(Channel::open);
    case Request::listen:
      return open(Channel::listening);
    case Request::close:
      if (!is_open()) return false;
      channel_ = Channel::closed;
      return true;
    case Request::bitrate:
      has_bitrate_ = has_bitrate_ || !is_open();
      return !is_open();
    case Request::data_bitrate:
      fd_ = fd_ || !is_open();
      return !is_open();
    case Request::stamps_off:
    case Request::stamps_on:
      if (!is_open()) stamps_ = request == Request::stamps_on;
      return !is_open();
    case Request::other:
      return true;
    default:
      return false;
  }
}

bool SimSlcan::open(Channel channel) {
  if (is_open() || !has_bitrate_) return false;
  channel_ = channel;
  confirmed_off_ = false;
  recover();
  return true;
}

// Frames from the devices; dropped while the channel is closed.
void SimSlcan::pass_on(std::int64_t now_ns, std::string& out) {
  for (; const Frame* frame = answers().front(); answers().pop()) {
    std::array<char, slcan::kLongestLine> text{};
    const std::size_t size = is_open() && (fd_ || !frame->fd) ? slcan::format_frame(*frame, text) : 0;
    if (size == 0) continue;
    out.append(text.data(), size - 1);
    if (stamps_) {
      const auto stamp_ms = static_cast<unsigned>(now_ns / kNsPerMs % kStampPeriodMs);
      for (const unsigned shift : {12U, 8U, 4U, 0U}) out += kHexDigits[stamp_ms >> shift & 15];
    }
    out += slcan::kDone;
  }
}

void SimSlcan::refuse(std::string& out) const { say(kRefused, out); }

// Answers that only a LAWICEL adapter sends.
void SimSlcan::say(std::string_view manners, std::string& out) const {
  if (manners_ == SlcanManners::lawicel) out += manners;
}

}  // namespace lithe::hal::sim
