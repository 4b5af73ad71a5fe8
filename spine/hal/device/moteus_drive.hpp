// SPDX-License-Identifier: Apache-2.0
// A moteus as the rest of the robot sees it: any drive.
#pragma once

#include "spine/core/rt.hpp"
#include "spine/hal/device/drive.hpp"
#include "spine/hal/device/moteus.hpp"

namespace lithe::hal::moteus {

// One command and one answer per exchange. Contract: as hal::Drive
class MoteusDrive final : public Drive {
 public:
  explicit MoteusDrive(const DriverParams& params) : driver_(params) {}

  bool command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT override;
  Heard take(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT override;

 private:
  Driver driver_;
};

}  // namespace lithe::hal::moteus
