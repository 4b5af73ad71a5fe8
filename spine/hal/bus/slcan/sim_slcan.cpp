// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/slcan/sim_slcan.hpp"

#include <array>

#include "spine/hal/bus/serial/words.hpp"

namespace lithe::hal::sim {

using slcan::Request;

namespace {

constexpr std::string_view kDone = "\r";
constexpr std::string_view kRefused = "\a";
constexpr std::int64_t kStampPeriodMs = 60'000;
constexpr std::int64_t kNsPerMs = 1'000'000;

// An answer to a question, or nothing.
std::string_view answer_to(Request request, bool is_open) {
  if (request == Request::version) return "V1013\r";
  if (request == Request::serial) return "NLTHE\r";
  return request == Request::status && is_open ? "F00\r" : "";
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
  if (request == Request::open) return open(Channel::open);
  if (request == Request::listen) return open(Channel::listening);
  if (request == Request::other) return true;
  const bool stamps = request == Request::stamps_off || request == Request::stamps_on;
  const bool sets = stamps || request == Request::bitrate || request == Request::data_bitrate;
  if (is_open() ? request != Request::close : !sets) return false;
  channel_ = Channel::closed;
  has_bitrate_ = has_bitrate_ || request == Request::bitrate;
  fd_ = fd_ || request == Request::data_bitrate;
  if (stamps) stamps_ = request == Request::stamps_on;
  return true;
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
