// SPDX-License-Identifier: Apache-2.0
// Where the code of laws lives. dlopen is the portable back end; another one may take its place behind this interface.
#pragma once

#include <cstdint>
#include <span>

#include "lithe/law.hpp"
#include "spine/law/resident.hpp"

namespace lithe::load {

// Contract: Loader thread only · never in the tick · a failed load leaves the place empty
class LawStore {
 public:
  LawStore() = default;
  LawStore(const LawStore&) = delete;
  LawStore& operator=(const LawStore&) = delete;
  virtual ~LawStore() = default;

  // Brings the object at `path` into an empty place (0..law::kResidents-1), every symbol resolved and every page of it
  // touched. nullptr, and one sentence in `why`, when that is not possible. The descriptor is not checked yet.
  virtual const LitheLaw* load(std::uint32_t place, const char* path, std::span<char> why) = 0;

  // Gives the place back. Nobody may still run its code.
  virtual void unload(std::uint32_t place) = 0;
};

}  // namespace lithe::load
