// SPDX-License-Identifier: Apache-2.0
// What the tick does with a candidate that nothing speaks against.
#pragma once

#include <optional>

#include "spine/law/slot.hpp"

namespace lithe::law {

template <class AnySlot>
std::optional<Commit> commit_next(AnySlot& slot) {
  Resident* candidate = slot.take();
  if (candidate == nullptr) return std::nullopt;
  return slot.commit(*candidate);
}

}  // namespace lithe::law
