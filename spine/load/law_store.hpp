// SPDX-License-Identifier: Apache-2.0
// Where the code of laws lives: in the arena, or wherever dlopen puts it.
#pragma once

#include <cstdint>
#include <span>

#include "lithe/law.hpp"
#include "spine/law/resident.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::load {

// Contract: Loader thread only · never in the tick · a failed load leaves the place empty
class LawStore {
 public:
  LawStore() = default;
  LawStore(const LawStore&) = delete;
  LawStore& operator=(const LawStore&) = delete;
  virtual ~LawStore() = default;

  // Brings the requested code into an empty place (0..law::kResidents-1), every symbol resolved and every page of it
  // touched. Anything but `staged` comes with one sentence in `why`. The descriptor itself is the Loader's to check.
  virtual wire::StageResult load(std::uint32_t place, const wire::StageRequest& request, const LitheLaw*& law,
                                 std::span<char> why) = 0;

  // Gives the place back. Nobody may still run its code.
  virtual void unload(std::uint32_t place) = 0;
};

}  // namespace lithe::load
