// SPDX-License-Identifier: Apache-2.0
// The last seconds of a running robot's telemetry, and the State of the law that runs.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "lithe/law.hpp"
#include "spine/ipc/layout.hpp"

namespace lithe::trial {

// Contract: allocates when made, never after
class Recording {
 public:
  Recording() = default;
  // The newest records of a robot that runs, at most `seconds`; empty when none runs, or one with other joints. Records
  // with a non-finite value are left out. `values_hash`: of the robot file (spine/robot/values.hpp).
  Recording(const std::string& robot, std::uint64_t values_hash, std::uint32_t joints, double dt_s, double seconds);

  // The robot that runs was started with other values than this robot file has.
  bool of_another() const { return of_another_; }

  std::size_t size() const { return records_.size(); }

  // Record i (0 = the oldest) as a law would have seen it.
  void fill(Tick& tick, std::size_t i) const;
  double command_torque_nm(std::size_t i, std::uint32_t joint) const { return at(i, command, joint); }

  // Copies into `state` what this law would get of the running law's State at its commit; its number of fields.
  std::uint32_t carry(const LitheLaw& law, std::span<std::byte> state) const;

  // The newest ticks first, at most `most`. Without a recording: a robot that follows a slow sine.
  std::vector<PastTick> past(std::size_t most, std::uint32_t joints, double dt_s) const;

 private:
  struct Record {
    std::uint64_t tick = 0;
    std::int64_t t_ns = 0;
    std::int64_t sample_ns = 0, brain_age_ns = 0;
    std::uint32_t flags = 0;
    std::array<double, kMaxSensors> sensor{};
    std::array<double, kMaxInputs> input{};
    std::int64_t input_age_ns = -1;
  };
  enum Quantity { position, velocity, torque, setpoint_position, setpoint_velocity, command, kQuantities };
  void read_state(const ipc::SpineMemory& spine);
  double at(std::size_t i, Quantity quantity, std::uint32_t joint) const {
    return values_[(i * kQuantities + quantity) * joints_ + joint];
  }

  std::uint32_t joints_ = 0;
  double dt_s_ = 1e-3;
  bool of_another_ = false;
  std::vector<Record> records_;
  std::vector<double> values_;
  LitheLaw running_{};  // of it only the State's description; without fields: no law runs, or it has none
  std::array<std::byte, kMaxStateBytes> state_{};
};

}  // namespace lithe::trial
