// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/pi3hat_bus.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>
#include <utility>

namespace lithe::hal {

Pi3hatBoard::Pi3hatBoard(std::unique_ptr<Pi3hatPort> port, const Pi3hatBoardParams& params)
    : port_(std::move(port)), params_(params) {
  for (std::size_t i = 0; i < lines_.size(); ++i) lines_[i].fd = params.port.lines[i].data_bitrate > 0;
}

// The board knows neither formats nor kinds of identifiers per frame: the connector decides the one, the number the
// other.
bool Pi3hatBoard::send(std::uint32_t connector, const Frame& frame, bool answered) LITHE_RT {
  const bool sayable = frame.fd == line(connector).fd && frame.extended == (frame.id > kLargestStandardId);
  if (sent_ == outbound_.size() || !sayable || !is_can(frame)) return false;
  outbound_[sent_++] = {connector, answered, frame};
  return true;
}

bool Pi3hatBoard::receive(std::uint32_t connector, Frame& frame) LITHE_RT {
  FrameQueue& queue = line(connector).inbound;
  if (due_ || (params_.polled && queue.size() == 0)) cycle();
  const Frame* next = queue.front();
  if (next == nullptr) return false;
  frame = *next;
  queue.pop();
  return true;
}

void Pi3hatBoard::cycle() LITHE_RT {
  due_ = false;
  Pi3hatAttitude attitude;
  const Pi3hatOrder order{std::span(outbound_).first(sent_), listen_, params_.reply_wait_ns, wants_imu_};
  const Pi3hatOutcome outcome = port_->cycle(order, inbound_, attitude);
  ++cycles_;
  sent_ = 0;
  error_.store(outcome.error, std::memory_order_relaxed);
  if (outcome.attitude) take(attitude);
  for (const Pi3hatFrame& each : std::span(inbound_).first(std::min(outcome.received, inbound_.size()))) {
    if (each.connector < 1 || each.connector > kPi3hatConnectors || (listen_ >> each.connector & 1) == 0) continue;
    Line& its = line(each.connector);
    if (!its.inbound.push(each.frame)) ++its.lost;
  }
}

void Pi3hatBoard::take(const Pi3hatAttitude& attitude) LITHE_RT {
  constexpr double kRadPerDegree = std::numbers::pi / 180;
  auto out = imu_.value.begin();
  double norm = 0;
  for (const double each : attitude.attitude) {
    *out++ = each;
    norm += each * each;
  }
  for (const double each : attitude.rate_dps) *out++ = each * kRadPerDegree;
  for (const double each : attitude.acceleration_mps2) *out++ = each;
  // A board that has just started says zeros, a spoilt transfer anything: neither is an attitude.
  constexpr double kNearlyOne = 0.1;
  const auto finite = [](double each) LITHE_RT { return std::isfinite(each); };
  imu_.valid = std::abs(norm - 1) < kNearlyOne && std::all_of(imu_.value.begin(), imu_.value.end(), finite);
  imu_.taken_ns = now_ns_;
}

const ImuReading& Pi3hatBoard::imu(std::int64_t /*now_ns*/) LITHE_RT { return imu_; }

std::string Pi3hatBoard::why_down() const {
  const int error = error_.load(std::memory_order_relaxed);
  if (error == 0) return "";
  return "the pi3hat reports error " + std::to_string(error) + "; check that it sits firmly and has its supply";
}

bool Pi3hatBus::send(const Frame& frame) LITHE_RT {
  const bool taken = board_->send(connector_, frame, std::exchange(answered_, false));
  ++(taken ? statistics_.sent : statistics_.refused);
  return taken;
}

bool Pi3hatBus::receive(Frame& frame) LITHE_RT {
  const bool any = board_->receive(connector_, frame);
  statistics_.late = board_->lost(connector_);
  if (any) ++statistics_.received;
  return any;
}

}  // namespace lithe::hal
