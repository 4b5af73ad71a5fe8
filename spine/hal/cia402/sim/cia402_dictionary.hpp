// SPDX-License-Identifier: Apache-2.0
// The object dictionary of a simulated CiA 402 drive: objects, lengths, access rights.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"

namespace lithe::hal::sim {

// Parameters of a dictionary.
struct Cia402Identity {
  std::uint32_t id = 1;
  std::uint32_t device_type = 0x0002'0192;
  std::uint32_t rated_torque_mnm = 1000;
  std::uint32_t counts_per_rev = 4096;
};

// Numbers of 1, 2 or 4 bytes by index and subindex, and a few texts.
// Contract: RT but for the constructor · one thread
class Cia402Dictionary {
 public:
  using Slot = std::size_t;  // index of an object; never changes

  explicit Cia402Dictionary(const Cia402Identity& identity);

  // Restores the initial values: `all`, or only the communication objects (1000h to 1FFFh).
  void restore(bool all) LITHE_RT;

  std::optional<Slot> find(canopen::Address address) const LITHE_RT;
  bool has_index(std::uint16_t index) const LITHE_RT;
  canopen::Address address(Slot slot) const LITHE_RT { return objects_[slot].address; }
  std::uint8_t bytes(Slot slot) const LITHE_RT { return objects_[slot].bytes; }
  bool writable(Slot slot) const LITHE_RT { return objects_[slot].writable; }
  bool mappable(Slot slot) const LITHE_RT { return objects_[slot].address.index >= 0x6000; }

  // Raw value, not sign-extended.
  std::uint32_t raw(Slot slot) const LITHE_RT { return objects_[slot].value; }
  void set_raw(Slot slot, std::uint32_t value) LITHE_RT;

  // Length of an object [bytes]; 0 when it does not exist.
  std::uint32_t value(std::uint16_t index, std::uint8_t subindex = 0) const LITHE_RT;
  std::int32_t signed_value(std::uint16_t index, std::uint8_t subindex = 0) const LITHE_RT;
  void set(std::uint16_t index, std::uint32_t value, std::uint8_t subindex = 0) LITHE_RT;

  // Empty = not a text object.
  std::string_view text(canopen::Address address) const LITHE_RT;

 private:
  struct Object {
    canopen::Address address;
    std::uint8_t bytes;
    bool writable;
    std::uint32_t initial;
    std::uint32_t value;
  };

  void add(std::uint16_t index, std::uint8_t subindex, std::uint8_t bytes, bool writable, std::uint32_t initial);
  void add_communication(const Cia402Identity& identity);
  void add_pdos(std::uint32_t id);
  void add_drive(const Cia402Identity& identity);
  void add_motion();

  std::vector<Object> objects_;  // by index, then subindex
};

}  // namespace lithe::hal::sim
