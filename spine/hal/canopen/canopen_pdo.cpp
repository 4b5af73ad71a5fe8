// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen_pdo.hpp"

#include <algorithm>

#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::canopen {

Frame PdoMap::pack(std::uint32_t id, std::span<const std::uint32_t> values) const LITHE_RT {
  Frame frame = blank(id, bytes_);
  std::size_t at = 0;
  for (std::size_t i = 0; i < count_; ++i) {
    if (i < values.size()) put(frame.data.data() + at, values[i], objects_[i].bytes);
    at += objects_[i].bytes;
  }
  return frame;
}

bool PdoMap::unpack(const Frame& frame, std::span<std::uint32_t> values) const LITHE_RT {
  if (!is_canopen(frame) || frame.size < bytes_) return false;
  std::size_t at = 0;
  for (std::size_t i = 0; i < std::min(count_, values.size()); ++i) {
    values[i] = get(frame.data.data() + at, objects_[i].bytes);
    at += objects_[i].bytes;
  }
  return true;
}

}  // namespace lithe::hal::canopen
