// SPDX-License-Identifier: Apache-2.0
// The object dictionary of a simulated CiA 402 drive: objects, lengths, access rights.
#pragma once

#include <cstdint>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/canopen/sim_objects.hpp"

namespace lithe::hal::sim {

// Parameters of a dictionary.
struct Cia402Identity {
  std::uint32_t id = 1;
  std::uint32_t device_type = 0x0002'0192;
  std::uint32_t rated_torque_mnm = 1000;
  std::uint32_t counts_per_rev = 4096;
};

// As after power-on, and a few texts.
// Contract: as ObjectDictionary
class Cia402Dictionary final : public ObjectDictionary {
 public:
  explicit Cia402Dictionary(const Cia402Identity& identity);

  bool mappable(Slot slot) const LITHE_RT { return address(slot).index >= 0x6000; }
  // Empty = not a text object.
  static std::string_view text(canopen::Address address) LITHE_RT;

 private:
  void add_communication(const Cia402Identity& identity);
  void add_pdos(std::uint32_t id);
  void add_drive(const Cia402Identity& identity);
  void add_motion();
};

}  // namespace lithe::hal::sim
