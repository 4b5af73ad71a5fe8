// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/sim_objects.hpp"

#include <algorithm>
#include <array>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"

namespace lithe::hal::sim {

using canopen::Address;
namespace abort_code = canopen::abort_code;

namespace {

std::uint32_t key(Address address) LITHE_RT { return std::uint32_t{address.index} << 8 | address.subindex; }

}  // namespace

void ObjectDictionary::add(std::uint16_t index, std::uint8_t subindex, std::uint8_t bytes, bool writable,
                           std::uint32_t initial) {
  const Object object{{index, subindex}, bytes, writable, initial, initial};
  const auto behind = std::upper_bound(objects_.begin(), objects_.end(), object, [](const Object& a, const Object& b) {
    return key(a.address) < key(b.address);
  });
  objects_.insert(behind, object);
}

void ObjectDictionary::restore(bool all) LITHE_RT {
  for (Object& object : objects_)
    if (all || object.address.index < 0x2000) object.value = object.initial;
}

ObjectDictionary::Slot ObjectDictionary::first_from(Address address) const LITHE_RT {
  const auto at = std::lower_bound(objects_.begin(), objects_.end(), address,
                                   [](const Object& a, Address b) { return key(a.address) < key(b); });
  return static_cast<Slot>(at - objects_.begin());
}

std::optional<ObjectDictionary::Slot> ObjectDictionary::find(Address address) const LITHE_RT {
  const Slot at = first_from(address);
  return at < objects_.size() && objects_[at].address == address ? std::optional(at) : std::nullopt;
}

bool ObjectDictionary::has_index(std::uint16_t index) const LITHE_RT {
  const Slot at = first_from({index, 0});
  return at < objects_.size() && objects_[at].address.index == index;
}

void ObjectDictionary::set_raw(Slot slot, std::uint32_t value) LITHE_RT {
  const unsigned bits = 8U * objects_[slot].bytes;
  objects_[slot].value = bits == 32 ? value : value & ((1U << bits) - 1);
}

std::uint32_t ObjectDictionary::value(std::uint16_t index, std::uint8_t subindex) const LITHE_RT {
  const std::optional<Slot> slot = find({index, subindex});
  return slot ? raw(*slot) : 0;
}

std::int32_t ObjectDictionary::signed_value(std::uint16_t index, std::uint8_t subindex) const LITHE_RT {
  const std::optional<Slot> slot = find({index, subindex});
  return slot ? canopen::signed_of(raw(*slot), bytes(*slot)) : 0;
}

void ObjectDictionary::set(std::uint16_t index, std::uint32_t value, std::uint8_t subindex) LITHE_RT {
  if (const std::optional<Slot> slot = find({index, subindex})) set_raw(*slot, value);
}

Frame SdoServer::abort(Address address, std::uint32_t why) const LITHE_RT {
  return canopen::sdo_abort(canopen::cob::kSdoAnswer + node_, address, why);
}

std::uint32_t SdoServer::lacks(std::uint16_t index) const LITHE_RT {
  return objects_.has_index(index) ? abort_code::kNoSubindex : abort_code::kNoObject;
}

bool SdoServer::serve(const Frame& frame, Frame& answer) LITHE_RT {
  constexpr std::uint8_t kKind = 0xe0;
  constexpr std::uint8_t kSegmentRead = 0x60, kWrite = 0x20, kRead = 0x40, kAbort = 0x80, kToggle = 0x10;
  if (frame.size != 8) {
    ++refused_;
    return false;
  }
  const Address address = canopen::sdo_address(frame);
  switch (frame.data[0] & kKind) {
    case kRead:
      answer = read(address);
      return true;
    case kSegmentRead:
      answer = read_segment((frame.data[0] & kToggle) != 0);
      return true;
    case kWrite: {
      const std::uint32_t why = write(frame, address);
      answer = why == abort_code::kNone ? canopen::sdo_written_answer(node_, address) : abort(address, why);
      return true;
    }
    case kAbort:
      upload_ = {};
      return false;
    default:
      ++refused_;
      answer = abort(address, abort_code::kCommand);
      return true;
  }
}

Frame SdoServer::read(Address address) LITHE_RT {
  const std::string_view words = text(address);
  if (!words.empty()) {
    upload_ = words;
    upload_toggle_ = false;
    return canopen::sdo_long_answer(node_, address, static_cast<std::uint32_t>(words.size()));
  }
  const auto slot = objects_.find(address);
  if (!slot) return abort(address, lacks(address.index));
  return canopen::sdo_read_answer(node_, address, read_object(*slot), objects_.bytes(*slot));
}

Frame SdoServer::read_segment(bool toggle) LITHE_RT {
  constexpr std::size_t kSegment = 7;
  if (upload_.empty() || toggle != upload_toggle_) {
    const std::uint32_t why = upload_.empty() ? abort_code::kCommand : abort_code::kToggle;
    upload_ = {};
    return abort({}, why);
  }
  std::array<std::uint8_t, kSegment> data{};
  const std::size_t bytes = std::min(upload_.size(), kSegment);
  std::transform(upload_.begin(), upload_.begin() + static_cast<std::ptrdiff_t>(bytes), data.begin(),
                 [](char letter) { return static_cast<std::uint8_t>(letter); });
  upload_ = {upload_.data() + bytes, upload_.size() - bytes};
  upload_toggle_ = !toggle;
  return canopen::sdo_segment_answer(node_, toggle, {data.data(), bytes}, upload_.empty());
}

std::uint32_t SdoServer::write(const Frame& frame, Address address) LITHE_RT {
  constexpr std::uint8_t kExpedited = 0x02, kSaysSize = 0x01;
  const std::uint8_t command = frame.data[0];
  if ((command & kExpedited) == 0) return abort_code::kCommand;
  const auto slot = objects_.find(address);
  if (!slot) return text(address).empty() ? lacks(address.index) : abort_code::kReadOnly;
  if (!objects_.writable(*slot)) return abort_code::kReadOnly;
  const std::size_t bytes = canopen::sdo_expedited_bytes(command), wanted = objects_.bytes(*slot);
  if ((command & kSaysSize) != 0 ? bytes != wanted : bytes < wanted) return abort_code::kLength;
  return write_object(*slot, little_endian(frame.data.data() + 4, wanted));
}

}  // namespace lithe::hal::sim
