// SPDX-License-Identifier: Apache-2.0
// The objects of a simulated CANopen node, and the server that reads and writes them for others.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "spine/core/pinned.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::sim {

inline constexpr bool kReadOnly = false, kWritable = true;

// Numbers of 1, 2 or 4 bytes by index and subindex.
// Contract: RT but for add() and the constructor of a node · one thread
class ObjectDictionary {
 public:
  using Slot = std::size_t;  // index of an object; never changes after the last add()

  // Contract: never in the tick
  void add(std::uint16_t index, std::uint8_t subindex, std::uint8_t bytes, bool writable, std::uint32_t initial);

  // Restores the initial values: `all`, or only the communication objects (1000h to 1FFFh).
  void restore(bool all) LITHE_RT;

  std::optional<Slot> find(canopen::Address address) const LITHE_RT;
  bool has_index(std::uint16_t index) const LITHE_RT;
  canopen::Address address(Slot slot) const LITHE_RT { return objects_[slot].address; }
  std::uint8_t bytes(Slot slot) const LITHE_RT { return objects_[slot].bytes; }
  bool writable(Slot slot) const LITHE_RT { return objects_[slot].writable; }

  // Raw value, not sign-extended.
  std::uint32_t raw(Slot slot) const LITHE_RT { return objects_[slot].value; }
  void set_raw(Slot slot, std::uint32_t value) LITHE_RT;

  // 0 when it does not exist.
  std::uint32_t value(std::uint16_t index, std::uint8_t subindex = 0) const LITHE_RT;
  std::int32_t signed_value(std::uint16_t index, std::uint8_t subindex = 0) const LITHE_RT;
  void set(std::uint16_t index, std::uint32_t value, std::uint8_t subindex = 0) LITHE_RT;

 private:
  struct Object {
    canopen::Address address;
    std::uint8_t bytes;
    bool writable;
    std::uint32_t initial;
    std::uint32_t value;
  };
  Slot first_from(canopen::Address address) const LITHE_RT;

  std::vector<Object> objects_;  // by index, then subindex
};

// The node's side of SDO: expedited transfers both ways, segmented upload of texts.
// Contract: RT but for the constructor · one thread · `objects` outlives it
class SdoServer : public Interface {
 public:
  SdoServer(std::uint32_t node, const ObjectDictionary& objects) : node_(node), objects_(objects) {}

 protected:
  // Serves a frame to 600h + node. False: it is not answered.
  bool serve(const Frame& frame, Frame& answer) LITHE_RT;
  void forget_upload() LITHE_RT { upload_ = {}; }

  std::uint64_t refused_ = 0;  // invalid frames

 private:
  virtual std::uint32_t read_object(ObjectDictionary::Slot slot) LITHE_RT = 0;
  // 0 or an abort code.
  virtual std::uint32_t write_object(ObjectDictionary::Slot slot, std::uint32_t value) LITHE_RT = 0;
  // Empty = not a text object.
  virtual std::string_view text(canopen::Address /*address*/) const LITHE_RT { return {}; }

  Frame read(canopen::Address address) LITHE_RT;
  Frame read_segment(bool toggle) LITHE_RT;
  std::uint32_t write(const Frame& frame, canopen::Address address) LITHE_RT;
  Frame abort(canopen::Address address, std::uint32_t why) const LITHE_RT;
  std::uint32_t lacks(std::uint16_t index) const LITHE_RT;

  std::uint32_t node_;
  const ObjectDictionary& objects_;
  std::string_view upload_;  // rest of the text being uploaded
  bool upload_toggle_ = false;
};

}  // namespace lithe::hal::sim
