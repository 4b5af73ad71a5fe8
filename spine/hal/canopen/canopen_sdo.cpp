// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen_sdo.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_text.hpp"

namespace lithe::hal::canopen {
namespace {

// The upper three bits of byte 0 are the command.
constexpr std::uint8_t kKind = 0xe0;
constexpr std::uint8_t kSegmentAnswer = 0x00;
constexpr std::uint8_t kReadAnswer = 0x40;
constexpr std::uint8_t kWrittenAnswer = 0x60;
constexpr std::uint8_t kAbort = 0x80;
constexpr std::uint8_t kToggle = 0x10;
constexpr std::uint8_t kExpedited = 0x02;
constexpr std::uint8_t kSizeSaid = 0x01;
constexpr std::uint8_t kLast = 0x01;
constexpr std::size_t kSegment = 7;

Frame frame_for(std::uint32_t id, std::uint8_t command, Address address, std::uint32_t value = 0, std::size_t bytes = 4)
    LITHE_RT {
  Frame frame = blank(id, 8);
  frame.data[0] = command;
  put_little_endian(frame.data.data() + 1, address.index, 2);
  frame.data[3] = address.subindex;
  put_little_endian(frame.data.data() + 4, value, bytes);
  return frame;
}

std::uint8_t expedited(std::uint8_t base, std::size_t bytes) LITHE_RT {
  return static_cast<std::uint8_t>(base | (4 - bytes) << 2 | kExpedited | kSizeSaid);
}

constexpr Names kAborts[] = {
    {abort_code::kToggle, "toggle bit not alternated"},
    {abort_code::kTimedOut, "no answer"},
    {abort_code::kCommand, "command not known"},
    {abort_code::kOutOfMemory, "out of memory"},
    {abort_code::kUnsupportedAccess, "access not supported"},
    {abort_code::kWriteOnly, "object is write-only"},
    {abort_code::kReadOnly, "object is read-only"},
    {abort_code::kNoObject, "no such object"},
    {abort_code::kNotMappable, "object cannot be mapped"},
    {abort_code::kPdoTooLong, "more than a PDO holds"},
    {abort_code::kLength, "wrong length"},
    {abort_code::kNoSubindex, "no such subindex"},
    {abort_code::kValue, "value out of range"},
    {abort_code::kState, "not in this state of the device"},
    {abort_code::kGeneral, "general error"},
};

}  // namespace

std::string_view abort_name(std::uint32_t code) LITHE_RT {
  return name_in(kAborts, code, "a reason of the maker's own");
}

void ObjectList::add(Address address) {
  if (address.index == last_ || address.index == without_) return;
  last_ = address.index;
  text_ += fmt::format("{}{:04X}h", text_.empty() ? "" : ", ", address.index);
}

std::uint32_t milliseconds(double seconds) {
  return static_cast<std::uint32_t>(std::clamp(std::round(1000 * seconds), 1.0, 65535.0));
}

Frame sdo_read_request(std::uint32_t node, Address address) LITHE_RT {
  return frame_for(cob::kSdoRequest + node, 0x40, address);
}

Frame sdo_write_request(std::uint32_t node, Address address, std::uint32_t value, std::size_t bytes) LITHE_RT {
  return frame_for(cob::kSdoRequest + node, expedited(0x20, bytes), address, value, bytes);
}

Frame sdo_segment_request(std::uint32_t node, bool toggle) LITHE_RT {
  return frame_for(cob::kSdoRequest + node, toggle ? 0x70 : 0x60, {});
}

Frame sdo_abort(std::uint32_t id, Address address, std::uint32_t code) LITHE_RT {
  return frame_for(id, kAbort, address, code);
}

Frame sdo_read_answer(std::uint32_t node, Address address, std::uint32_t value, std::size_t bytes) LITHE_RT {
  return frame_for(cob::kSdoAnswer + node, expedited(kReadAnswer, bytes), address, value, bytes);
}

Frame sdo_long_answer(std::uint32_t node, Address address, std::uint32_t bytes) LITHE_RT {
  return frame_for(cob::kSdoAnswer + node, kReadAnswer | kSizeSaid, address, bytes);
}

Frame sdo_segment_answer(std::uint32_t node, bool toggle, std::span<const std::uint8_t> data, bool last) LITHE_RT {
  Frame frame = blank(cob::kSdoAnswer + node, 8);
  const std::size_t bytes = std::min(data.size(), kSegment);
  frame.data[0] = static_cast<std::uint8_t>((toggle ? kToggle : 0) | (kSegment - bytes) << 1 | (last ? kLast : 0));
  std::copy_n(data.begin(), bytes, frame.data.begin() + 1);
  return frame;
}

Frame sdo_written_answer(std::uint32_t node, Address address) LITHE_RT {
  return frame_for(cob::kSdoAnswer + node, kWrittenAnswer, address);
}

Address sdo_address(const Frame& frame) LITHE_RT {
  return {static_cast<std::uint16_t>(little_endian(frame.data.data() + 1, 2)), frame.data[3]};
}

std::size_t sdo_expedited_bytes(std::uint8_t command) LITHE_RT {
  return (command & kSizeSaid) != 0 ? 4 - ((command >> 2) & 3U) : 4;
}

void SdoClient::begin(Address address, bool writing) LITHE_RT {
  address_ = address;
  writing_ = writing;
  attempts_ = 0;
  abort_ = abort_code::kNone;
  phase_ = Phase::start;
}

void SdoClient::write(Address address, std::uint32_t value, std::size_t bytes) LITHE_RT {
  begin(address, true);
  value_ = value;
  bytes_ = bytes;
}

bool SdoClient::send_start(std::int64_t now_ns, Frame& frame) LITHE_RT {
  frame = writing_ ? sdo_write_request(node_, address_, value_, bytes_) : sdo_read_request(node_, address_);
  deadline_ns_ = now_ns + kTimeoutsNs[attempts_++];
  received_ = 0;
  segments_ = 0;
  toggle_ = false;
  phase_ = Phase::await_start;
  return true;
}

bool SdoClient::next(std::int64_t now_ns, Frame& frame) LITHE_RT {
  switch (phase_) {
    case Phase::start:
      return send_start(now_ns, frame);
    case Phase::segment:
      frame = sdo_segment_request(node_, toggle_);
      deadline_ns_ = now_ns + kTimeoutsNs[attempts_ - 1];
      phase_ = Phase::await_segment;
      return true;
    case Phase::await_start:
    case Phase::await_segment:
      if (now_ns < deadline_ns_) return false;
      // The node may still be busy with the old transfer: abort it before the next request.
      frame = sdo_abort(cob::kSdoRequest + node_, address_, abort_code::kTimedOut);
      abort_ = abort_code::kTimedOut;
      phase_ = attempts_ < kTimeoutsNs.size() ? Phase::start : Phase::failed;
      return true;
    case Phase::give_up:
      frame = sdo_abort(cob::kSdoRequest + node_, address_, abort_);
      phase_ = Phase::failed;
      return true;
    case Phase::idle:
    case Phase::done:
    case Phase::failed:
      break;
  }
  return false;
}

bool SdoClient::stray() LITHE_RT {
  ++strays_;
  return false;
}

bool SdoClient::fail(std::uint32_t code, Phase phase) LITHE_RT {
  abort_ = code;
  phase_ = phase;
  return true;
}

bool SdoClient::on_frame(const Frame& frame) LITHE_RT {
  if (!is_canopen(frame) || frame.id != cob::kSdoAnswer + node_ || frame.size != 8) return stray();
  if (phase_ == Phase::await_segment) return on_segment(frame);
  if (phase_ == Phase::await_start) return on_start_answer(frame);
  return stray();
}

bool SdoClient::on_start_answer(const Frame& frame) LITHE_RT {
  const std::uint8_t command = frame.data[0];
  const std::uint8_t kind = command & kKind;
  // An answer to an earlier, aborted request has another index and is ignored.
  if (kind == kSegmentAnswer || sdo_address(frame) != address_) return stray();
  if (command == kAbort) return fail(little_endian(frame.data.data() + 4, 4), Phase::failed);
  if (writing_) {
    if (kind != kWrittenAnswer) return stray();
    phase_ = Phase::done;
    return true;
  }
  if (kind != kReadAnswer) return stray();
  if ((command & kExpedited) == 0) {
    const bool too_long = (command & kSizeSaid) != 0 && little_endian(frame.data.data() + 4, 4) > kLongest;
    if (too_long) return fail(abort_code::kOutOfMemory, Phase::give_up);
    phase_ = Phase::segment;
    return true;
  }
  received_ = sdo_expedited_bytes(command);
  std::copy_n(frame.data.begin() + 4, received_, data_.begin());
  phase_ = Phase::done;
  return true;
}

bool SdoClient::on_segment(const Frame& frame) LITHE_RT {
  const std::uint8_t command = frame.data[0];
  if (command == kAbort) return fail(little_endian(frame.data.data() + 4, 4), Phase::failed);
  if ((command & kKind) != kSegmentAnswer) return stray();
  if (((command & kToggle) != 0) != toggle_) return stray();  // the segment before, once more
  const std::size_t bytes = kSegment - ((command >> 1) & 7U);
  // Counts segments, so that endless empty segments end too.
  if (received_ + bytes > kLongest || ++segments_ > kLongest) return fail(abort_code::kOutOfMemory, Phase::give_up);
  std::copy_n(frame.data.begin() + 1, bytes, data_.begin() + static_cast<std::ptrdiff_t>(received_));
  received_ += bytes;
  toggle_ = !toggle_;
  phase_ = (command & kLast) != 0 ? Phase::done : Phase::segment;
  return true;
}

SdoClient::Outcome SdoClient::outcome() const LITHE_RT {
  if (phase_ == Phase::idle) return Outcome::idle;
  if (phase_ == Phase::done) return Outcome::done;
  return phase_ == Phase::failed ? Outcome::failed : Outcome::busy;
}

std::uint32_t SdoClient::value() const LITHE_RT {
  return little_endian(data_.data(), std::min<std::size_t>(received_, 4));
}

}  // namespace lithe::hal::canopen
