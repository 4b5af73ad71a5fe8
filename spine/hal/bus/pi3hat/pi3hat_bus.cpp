// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/pi3hat/pi3hat_bus.hpp"

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

std::unique_ptr<Bus> Pi3hatBoard::open_bus(std::uint32_t connector) {
  return std::make_unique<Pi3hatBus>(shared_from_this(), connector);
}

// The board has no format or id type per frame: the connector decides the format, the value of the id its type.
bool Pi3hatBoard::send(std::uint32_t connector, const Frame& frame, bool answered) LITHE_RT {
  const bool sayable = frame.fd == line(connector).fd && frame.extended == (frame.id > kLargestStandardId);
  if (sent_ == outbound_.size() || !sayable || !is_can(frame)) return false;
  outbound_[sent_++] = {connector, answered && !in_steps_, frame};
  return true;
}

void Pi3hatBoard::begin(std::int64_t now_ns) LITHE_RT {
  now_ns_ = now_ns;
  if (!std::exchange(open_, true)) old_ = in_steps_;  // once for all connectors
}

void Pi3hatBoard::flush() LITHE_RT {
  open_ = false;
  due_ = true;
}

bool Pi3hatBoard::receive(std::uint32_t connector, Frame& frame) LITHE_RT {
  FrameQueue& queue = line(connector).inbound;
  if (in_steps_) {
    if (queue.size() == 0 || old_ || due_) look(connector);
  } else if (due_ || (params_.polled && queue.size() == 0)) {
    send_all(params_.reply_wait_ns, inbound_);
  }
  const Frame* next = queue.front();
  if (next == nullptr) return false;
  frame = *next;
  queue.pop();
  return true;
}

// Before the commands: read everything. After them: one cycle each time a connector asks again.
void Pi3hatBoard::look(std::uint32_t connector) LITHE_RT {
  if (std::exchange(old_, false)) return take_old();
  if (open_) return;
  if (due_) return send_all(0, {});
  const std::uint32_t bit = 1U << connector;
  if ((looked_ & bit) != 0) {
    looked_ = 0;
    cycle({{}, listen_, 0, false}, inbound_);
  }
  looked_ |= bit;
}

void Pi3hatBoard::take_old() LITHE_RT {
  for (int i = 0; i < kMostOldCycles && cycle({{}, listen_, 0, false}, inbound_) >= kLeastTaken; ++i) {
  }
}

void Pi3hatBoard::send_all(std::int64_t wait_ns, std::span<Pi3hatFrame> room) LITHE_RT {
  due_ = false;
  looked_ = 0;
  cycle({std::span(outbound_).first(sent_), listen_, wait_ns, wants_imu_}, room);
  sent_ = 0;
}

std::size_t Pi3hatBoard::cycle(const Pi3hatOrder& order, std::span<Pi3hatFrame> room) LITHE_RT {
  Pi3hatAttitude attitude;
  const Pi3hatOutcome outcome = port_->cycle(order, room, attitude);
  ++cycles_;
  error_.store(outcome.error, std::memory_order_relaxed);
  if (outcome.attitude) take(attitude);
  const std::size_t came = std::min(outcome.received, room.size());
  for (const Pi3hatFrame& each : room.first(came)) {
    if (each.connector < 1 || each.connector > kPi3hatConnectors || (listen_ >> each.connector & 1) == 0) continue;
    Line& its = line(each.connector);
    if (!its.inbound.push(each.frame)) ++its.lost;
  }
  return came;
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
  // A board that has just started sends zeros, and a damaged transfer any bytes: neither is a valid attitude.
  constexpr double kNearlyOne = 0.1;
  const auto finite = [](double each) LITHE_RT { return std::isfinite(each); };
  imu_.valid = std::abs(norm - 1) < kNearlyOne && std::all_of(imu_.value.begin(), imu_.value.end(), finite);
  imu_.taken_ns = now_ns_;
}

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

void Pi3hatBus::flush() LITHE_RT {
  answered_ = false;  // a drive that got no command does not answer
  board_->flush();
}

bool Pi3hatBus::receive(Frame& frame) LITHE_RT {
  const bool any = board_->receive(connector_, frame);
  statistics_.late = board_->lost(connector_);
  if (any) ++statistics_.received;
  return any;
}

}  // namespace lithe::hal
