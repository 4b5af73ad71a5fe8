// SPDX-License-Identifier: Apache-2.0
// Interface of the two back ends for the code of laws: the arena, or dlopen.
#pragma once

#include <cstdint>
#include <span>

#include "lithe/law.hpp"
#include "spine/law/resident.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::load {

// Contract: Loader thread only · never in the tick · a failed load leaves the index empty
class LawStore {
 public:
  LawStore() = default;
  LawStore(const LawStore&) = delete;
  LawStore& operator=(const LawStore&) = delete;
  virtual ~LawStore() = default;

  // Loads the requested code at an empty index (0..law::kResidents-1), with all symbols resolved and all pages touched.
  // Any result but `staged` has one sentence in `why`. The Loader checks the descriptor.
  virtual wire::StageResult load(std::uint32_t place, const wire::StageRequest& request, const LitheLaw*& law,
                                 std::span<char> why) = 0;

  // Frees the index. No thread may still run its code.
  virtual void unload(std::uint32_t place) = 0;
};

}  // namespace lithe::load
