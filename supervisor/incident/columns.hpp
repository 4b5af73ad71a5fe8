// SPDX-License-Identifier: Apache-2.0
// Telemetry records as a file that numpy opens: one structured array, with as many joints as the robot has.
#pragma once

#include <cstddef>
#include <string>

#include "spine/wire/wire.hpp"

namespace lithe::control {

// Contract: one thread, not the tick.
class Columns {
 public:
  explicit Columns(std::size_t joints) : joints_(joints) {}

  void add(wire::Telemetry& record);
  std::size_t rows() const { return rows_; }
  // The whole file: format .npy 1.0, little-endian, field names and units of wire::Telemetry.
  std::string npy() const;

 private:
  std::size_t joints_;
  std::size_t rows_ = 0;
  std::string bytes_;
};

}  // namespace lithe::control
