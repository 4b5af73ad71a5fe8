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

// A selection of the firmware's settings: those simulated here, and those that tools read. Each has a present value and
// a stored value, which is loaded at a restart.
// Contract: RT · one thread
class MoteusConfig {
 public:
  static constexpr std::size_t kEntries = 63;
  static constexpr std::size_t kNone = kEntries;

  // The initial stored values, and those of `conf default`.
  MoteusConfig(const ServoParams& servo, std::uint32_t id);

  // kNone for an unknown setting.
  static std::size_t find(std::string_view name) LITHE_RT;
  static std::string_view name(std::size_t entry) LITHE_RT;
  static bool is_integer(std::size_t entry) LITHE_RT;
  static bool is_group(std::string_view name) LITHE_RT;

  double value(std::size_t entry) const LITHE_RT { return now_[entry]; }
  // False: invalid value; the setting is unchanged.
  bool set(std::size_t entry, double value) LITHE_RT;

  void store() LITHE_RT { stored_ = now_; }
  void load() LITHE_RT { now_ = stored_; }
  void reset() LITHE_RT { now_ = factory_; }

  // Writes the settings with a name here into `params`.
  void act_on(ServoParams& params) const LITHE_RT;
  std::uint32_t id() const LITHE_RT;
  std::uint32_t prefix() const LITHE_RT;  // the upper 13 bits of the CAN ids that this drive accepts

 private:
  using Values = std::array<double, kEntries>;
  Values now_;
  Values stored_;
  Values factory_;
};

}  // namespace lithe::hal::sim
