// SPDX-License-Identifier: Apache-2.0
// SDO: one node reads and writes objects of another, one request and one answer of 8 bytes at a time. Expedited
// transfers (values of 1 to 4 bytes) both ways; segmented upload (for texts).
//
//   byte 0 of a request                     byte 0 of its answer
//   2f 2b 27 23  write 1, 2, 3, 4 bytes     60  written
//   40           read                       4f 4b 47 43  read 1, 2, 3, 4 bytes;  41  more than 4, its length follows
//   60 70        next segment (toggle)      0ttt: bit 4 toggle, bits 1-3 unused bytes of 7, bit 0 last one
//   80           abort                      80  abort: u32 why
// Bytes 1 to 3 are index and subindex, 4 to 7 the value, but in segments.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::canopen {

// Reason of an abort.
namespace abort_code {
inline constexpr std::uint32_t kNone = 0;
inline constexpr std::uint32_t kToggle = 0x0503'0000;
inline constexpr std::uint32_t kTimedOut = 0x0504'0000;
inline constexpr std::uint32_t kCommand = 0x0504'0001;
inline constexpr std::uint32_t kOutOfMemory = 0x0504'0005;
inline constexpr std::uint32_t kUnsupportedAccess = 0x0601'0000;
inline constexpr std::uint32_t kWriteOnly = 0x0601'0001;
inline constexpr std::uint32_t kReadOnly = 0x0601'0002;
inline constexpr std::uint32_t kNoObject = 0x0602'0000;
inline constexpr std::uint32_t kNotMappable = 0x0604'0041;
inline constexpr std::uint32_t kPdoTooLong = 0x0604'0042;
inline constexpr std::uint32_t kLength = 0x0607'0010;
inline constexpr std::uint32_t kNoSubindex = 0x0609'0011;
inline constexpr std::uint32_t kValue = 0x0609'0030;
inline constexpr std::uint32_t kGeneral = 0x0800'0000;
inline constexpr std::uint32_t kState = 0x0800'0022;
}  // namespace abort_code

// Text without the number; never empty.
// Contract: any thread
std::string_view abort_name(std::uint32_t code) LITHE_RT;

struct Address {
  std::uint16_t index = 0;
  std::uint8_t subindex = 0;
  bool operator==(const Address&) const = default;
};

// The object that an entry of a PDO mapping (1600h to 17FFh, 1A00h to 1BFFh) names; of another object: itself.
inline Address mapped_or_self(Address address, std::uint32_t value) LITHE_RT {
  const int block = address.index & 0xfe00;
  const bool entry = (block == 0x1600 || block == 0x1a00) && address.subindex > 0;
  return entry ? Address{static_cast<std::uint16_t>(value >> 16), static_cast<std::uint8_t>(value >> 8)} : address;
}

// Why a node is not ready: a kind of its profile (0 = it is ready), the object it is about, and a number.
template <class Kind>
struct NotReady {
  Kind kind{};
  Address address{};
  std::uint32_t value = 0;

  // In one word of 64 bits, so that other threads may read it.
  std::uint64_t packed() const LITHE_RT {
    return std::uint64_t{static_cast<std::uint8_t>(kind)} << 56 | std::uint64_t{address.subindex} << 48 |
           std::uint64_t{address.index} << 32 | value;
  }
  static NotReady unpacked(std::uint64_t word) LITHE_RT {
    return {static_cast<Kind>(word >> 56),
            {static_cast<std::uint16_t>(word >> 32), static_cast<std::uint8_t>(word >> 48)},
            static_cast<std::uint32_t>(word)};
  }
};

// The indices of these objects but for one, once each, for example "1600h, 6007h".
// Contract: never in the tick
class ObjectList {
 public:
  explicit ObjectList(std::uint16_t without) : last_(without), without_(without) {}
  void add(Address address);
  const std::string& text() const { return text_; }

 private:
  std::uint16_t last_, without_;
  std::string text_;
};

// Seconds as the milliseconds of an object, 1 to 65535.
// Contract: never in the tick
std::uint32_t milliseconds(double seconds);

// Frames of both sides. `bytes` is 1 to 4.
Frame sdo_read_request(std::uint32_t node, Address address) LITHE_RT;
Frame sdo_write_request(std::uint32_t node, Address address, std::uint32_t value, std::size_t bytes) LITHE_RT;
Frame sdo_segment_request(std::uint32_t node, bool toggle) LITHE_RT;
Frame sdo_abort(std::uint32_t id, Address address, std::uint32_t code) LITHE_RT;
Frame sdo_read_answer(std::uint32_t node, Address address, std::uint32_t value, std::size_t bytes) LITHE_RT;
Frame sdo_long_answer(std::uint32_t node, Address address, std::uint32_t bytes) LITHE_RT;
Frame sdo_segment_answer(std::uint32_t node, bool toggle, std::span<const std::uint8_t> data, bool last) LITHE_RT;
Frame sdo_written_answer(std::uint32_t node, Address address) LITHE_RT;

Address sdo_address(const Frame& frame) LITHE_RT;
// Number of bytes in an expedited transfer; 4 when it is not given.
std::size_t sdo_expedited_bytes(std::uint8_t command) LITHE_RT;

// One transfer at a time with one node; at most one frame leaves per call of next(). A request
// without an answer is aborted and repeated, three times in all, and each waits longer (kTimeoutsNs). An answer counts
// for as long as its object is asked for, so up to 1.4 s after the first request; one that comes later, or twice, is
// dropped. (An SDO has no number: of one object, the answer to the first request and that to the second are alike.)
// Contract: RT · one thread · time is an argument · answers are bounded by kLongest
class SdoClient {
 public:
  static constexpr std::size_t kLongest = 64;  // bytes of an upload; a longer one is aborted
  // Of each attempt. The first is short, because a frame may be lost; the last long, since a drive may store the value.
  static constexpr std::array<std::int64_t, 3> kTimeoutsNs{100'000'000, 300'000'000, 1'000'000'000};

  enum class Outcome : std::uint8_t { idle, busy, done, failed };

  explicit SdoClient(std::uint32_t node) : node_(node) {}

  void read(Address address) LITHE_RT { begin(address, false); }
  void write(Address address, std::uint32_t value, std::size_t bytes) LITHE_RT;
  void forget() LITHE_RT { phase_ = Phase::idle; }

  // The frame to send now. False: nothing to send.
  bool next(std::int64_t now_ns, Frame& frame) LITHE_RT;
  // Handles a frame from 580h + node. False: not an answer to the present request.
  bool on_frame(const Frame& frame) LITHE_RT;

  Outcome outcome() const LITHE_RT;
  Address address() const LITHE_RT { return address_; }
  // Data of a finished upload.
  std::span<const std::uint8_t> data() const LITHE_RT { return {data_.data(), received_}; }
  std::uint32_t value() const LITHE_RT;
  // Abort code of a failed transfer; kTimedOut without an answer.
  std::uint32_t abort() const LITHE_RT { return abort_; }
  std::uint64_t strays() const LITHE_RT { return strays_; }

 private:
  enum class Phase : std::uint8_t { idle, start, await_start, segment, await_segment, give_up, done, failed };

  void begin(Address address, bool writing) LITHE_RT;
  bool send_start(std::int64_t now_ns, Frame& frame) LITHE_RT;
  bool on_start_answer(const Frame& frame) LITHE_RT;
  bool on_segment(const Frame& frame) LITHE_RT;
  bool fail(std::uint32_t code, Phase phase) LITHE_RT;
  bool stray() LITHE_RT;

  std::uint32_t node_;
  Phase phase_ = Phase::idle;
  Address address_;
  bool writing_ = false;
  bool toggle_ = false;
  std::uint32_t value_ = 0;
  std::size_t bytes_ = 0;
  std::size_t received_ = 0;
  std::uint32_t segments_ = 0;
  std::size_t attempts_ = 0;
  std::uint32_t abort_ = abort_code::kNone;
  std::uint64_t strays_ = 0;
  std::int64_t deadline_ns_ = 0;
  std::array<std::uint8_t, kLongest> data_{};
};

}  // namespace lithe::hal::canopen
