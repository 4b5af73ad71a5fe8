// SPDX-License-Identifier: Apache-2.0
// Observes the frames of a running robot's buses.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "spine/core/rt.hpp"
#include "spine/hal/core/bus.hpp"

namespace lithe::hal {

// Contract: RT · the exchange's thread · outlives the buses
class FrameTap : public Interface {
 public:
  // True when the frames of the exchange that begins now are watched.
  virtual bool wanted(std::int64_t now_ns) LITHE_RT = 0;
  virtual void saw(std::uint32_t bus, bool outbound, const Frame& frame) LITHE_RT = 0;
  // Called regularly, watched or not.
  virtual void counted(std::uint32_t bus, const BusStatistics& statistics) LITHE_RT = 0;
};

// A bus with a tap. When it is not watched, it costs one more call and one check per exchange.
// Contract: as Bus
class TappedBus final : public Bus {
 public:
  TappedBus(std::unique_ptr<Bus> bus, std::uint32_t number, FrameTap& tap)
      : bus_(std::move(bus)), number_(number), tap_(tap) {}

  void begin(std::int64_t now_ns) LITHE_RT override {
    bus_->begin(now_ns);
    watched_ = tap_.wanted(now_ns);
    if (++exchanges_ % kCountEvery == 0) tap_.counted(number_, bus_->statistics());
  }
  void expect_answer() LITHE_RT override { bus_->expect_answer(); }
  bool send(const Frame& frame) LITHE_RT override {
    const bool sent = bus_->send(frame);
    if (watched_ && sent) tap_.saw(number_, true, frame);
    return sent;
  }
  void flush() LITHE_RT override { bus_->flush(); }
  bool receive(Frame& frame) LITHE_RT override {
    const bool any = bus_->receive(frame);
    if (watched_ && any) tap_.saw(number_, false, frame);
    return any;
  }
  std::int64_t reply_wait_ns() const LITHE_RT override { return bus_->reply_wait_ns(); }
  void service() override { bus_->service(); }
  std::string why_down() const override { return bus_->why_down(); }
  const BusStatistics& statistics() const LITHE_RT override { return bus_->statistics(); }

 private:
  static constexpr std::uint64_t kCountEvery = 64;

  std::unique_ptr<Bus> bus_;
  std::uint32_t number_;
  FrameTap& tap_;
  bool watched_ = false;
  std::uint64_t exchanges_ = 0;
};

}  // namespace lithe::hal
