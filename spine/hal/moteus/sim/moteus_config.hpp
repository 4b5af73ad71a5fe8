// SPDX-License-Identifier: Apache-2.0
// The settings of a simulated moteus, by the names its firmware gives them: what the console reads and writes.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/sim/servo.hpp"

namespace lithe::hal::sim {

// A choice of the firmware's settings: those that act here, and those that tools want to read. Each lives twice: as it
// is, and as it is stored and comes back after a restart.
// Contract: RT · one thread
class MoteusConfig {
 public:
  static constexpr std::size_t kEntries = 63;
  static constexpr std::size_t kNone = kEntries;

  // What is stored at first, and what `reset` brings back, is this.
  MoteusConfig(const ServoParams& servo, std::uint32_t id);

  // kNone when there is no such setting.
  static std::size_t find(std::string_view name) LITHE_RT;
  static std::string_view name(std::size_t entry) LITHE_RT;
  static bool is_integer(std::size_t entry) LITHE_RT;
  static bool is_group(std::string_view name) LITHE_RT;

  double value(std::size_t entry) const LITHE_RT { return now_[entry]; }
  // False: a value the setting cannot have; it stays as it was.
  bool set(std::size_t entry, double value) LITHE_RT;

  void store() LITHE_RT { stored_ = now_; }
  void load() LITHE_RT { now_ = stored_; }
  void reset() LITHE_RT { now_ = factory_; }

  // The servo's settings that have a name here, over those in `params`.
  void act_on(ServoParams& params) const LITHE_RT;
  std::uint32_t id() const LITHE_RT;
  std::uint32_t prefix() const LITHE_RT;  // the upper 13 bits of the CAN id of what this drive listens to

 private:
  using Values = std::array<double, kEntries>;
  Values now_;
  Values stored_;
  Values factory_;
};

}  // namespace lithe::hal::sim
