// SPDX-License-Identifier: Apache-2.0
// For tests: two simulated drives on a loop bus; the frames of one can be damaged.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {

inline constexpr std::size_t kInPosition = 5;  // the last digit of the position in an answer

enum class Trick { none, drop, twice, stray, garble, hold_back, babble, contradict, contradict_later };

// A node between a drive and the bus that drops, damages, repeats or delays its answers.
class BadCable final : public BusNode {
 public:
  explicit BadCable(const sim::SimMoteusParams& params) : drive_(params) {}

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override {
    drive_.on_frame(frame, now_ns, fresh_);
    while (const Frame* answer = fresh_.front()) {
      Frame copy = *answer;
      fresh_.pop();
      play(copy, answers);
    }
  }

  void on_time(std::int64_t, FrameQueue& answers) LITHE_RT override {
    if (speaks_again_) answers.push(late_);
    speaks_again_ = false;
  }

  Trick trick = Trick::none;
  Frame* keep = nullptr;  // the next answer is copied here
  const Frame* replay = nullptr;
  std::mt19937 random{1};
  sim::SimMoteus& drive() { return drive_; }

 private:
  void play(Frame& answer, FrameQueue& answers) LITHE_RT {
    if (keep != nullptr) *keep = answer;
    if (replay != nullptr) answers.push(*replay);
    if (held_) {  // delayed frames come first: a bus keeps the order
      answers.push(late_);
      held_ = false;
    }
    switch (trick) {
      case Trick::drop:
        return;
      case Trick::twice:
        answers.push(answer);
        break;
      case Trick::contradict_later:
        late_ = answer;
        late_.data[kInPosition] ^= 1;
        speaks_again_ = true;
        break;
      case Trick::contradict:
        answers.push(answer);
        answer.data[kInPosition] ^= 1;
        break;
      case Trick::stray:
        answer.id = 99U << 8;
        break;
      case Trick::garble:
        answer.data[0] = 0x7f;
        break;
      case Trick::hold_back:
        late_ = answer;
        held_ = true;
        return;
      case Trick::babble:
        for (int i = 0; i < 100; ++i) answers.push(answer);
        return;
      case Trick::none:
        break;
    }
    answers.push(answer);
  }

  sim::SimMoteus drive_;
  FrameQueue fresh_;
  Frame late_;
  bool held_ = false;
  bool speaks_again_ = false;
};

// Two joints on one bus, each asked in one of `divider` exchanges; the frames of the second one can be damaged.
class TwoJoints : public testing::Test {
 protected:
  explicit TwoJoints(std::uint32_t divider = 1) {
    auto bus = std::make_unique<LoopBus>();
    bus_ = bus.get();
    for (std::uint32_t id : {1U, 2U}) {
      sim::SimMoteusParams params;
      params.id = id;
      params.plant.initial_position_rad = 0.1 * id;
      cables_.push_back(std::make_unique<BadCable>(params));
      bus_->attach(*cables_.back());
    }
    actuators_.add_bus(std::move(bus), hal::moteus::device_of);
    for (std::uint32_t id : {1U, 2U}) {
      moteus::DriverParams params;
      params.id = id;
      actuators_.add_joint(0, id, std::make_unique<moteus::MoteusDrive>(params), divider);
    }
    command_.joints = 2;
  }

  void cycle(Trick trick, int times = 1) {
    cables_[1]->trick = trick;
    for (int i = 0; i < times; ++i) {
      ++command_.tick;
      actuators_.cycle(command_, state_, now_ns_);
      now_ns_ += 1'000'000;
    }
  }
  bool fresh(std::size_t joint) const { return (state_.status[joint] & wire::joint_status::kFresh) != 0; }
  bool lost(std::size_t joint) const { return (state_.status[joint] & wire::joint_status::kLost) != 0; }

  LoopBus* bus_;
  std::vector<std::unique_ptr<BadCable>> cables_;
  BusActuators actuators_;
  ActuatorCommand command_;
  ActuatorState state_;
  std::int64_t now_ns_ = 1'000'000'000;
};

}  // namespace lithe::hal
