// SPDX-License-Identifier: Apache-2.0
// Actuators over any buses: one exchange per tick and bus, replies matched to joints by address.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "spine/core/rt.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/hal/bus/bus.hpp"
#include "spine/hal/device/moteus.hpp"

namespace lithe::hal {

// Contract: cycle() RT, bounded, one thread · add_bus and add_joint before the first cycle, never in the tick
class BusActuators final : public Actuators {
 public:
  // A joint is lost after this many exchanges without an answer.
  static constexpr std::uint32_t kMissesToLost = 3;

  std::size_t add_bus(std::unique_ptr<Bus> bus);
  // Joints in the order of the robot's joints, at most kMaxJoints; addresses differ on each bus.
  void add_joint(std::size_t bus, const moteus::DriverParams& params);

  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override;

  const ReplyCounters& counters() const LITHE_RT override { return counters_; }

 private:
  static constexpr std::uint8_t kNobody = 0xff;
  static_assert(kMaxJoints < kNobody);

  struct Line {
    std::unique_ptr<Bus> bus;
    std::size_t joints = 0;
    std::array<std::uint8_t, 128> joint_at;  // by device address
  };
  struct Joint {
    std::size_t line;
    moteus::Driver driver;
    std::uint32_t misses_in_a_row = 0;
    bool answered = false;
  };

  // Our address changes with every exchange, and the drives answer to it: so a late answer is known as such.
  static constexpr std::uint32_t kSources = 16;

  void send_all(const ActuatorCommand& command) LITHE_RT;
  void receive_all(Line& line) LITHE_RT;
  void accept(const Line& line, const Frame& frame) LITHE_RT;
  void settle() LITHE_RT;

  std::vector<Line> lines_;
  std::vector<Joint> joints_;
  ActuatorState last_;
  std::uint32_t source_ = 0;
  std::uint64_t late_answers_ = 0;
  ReplyCounters counters_;
};

}  // namespace lithe::hal
