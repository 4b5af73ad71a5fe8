// SPDX-License-Identifier: Apache-2.0
#include "spine/load/law_store.hpp"

#include <algorithm>
#include <bit>
#include <cstdio>

#include "spine/core/serialise.hpp"

namespace lithe::load {
namespace {

using wire::StageResult;

#if defined(__aarch64__)
constexpr std::uint64_t kCodeAlign = 4;
#else
constexpr std::uint64_t kCodeAlign = 1;
#endif

// An address range of the image in a slot.
struct Range {
  std::uint64_t from, bytes;
  bool holds(std::uint64_t at, std::uint64_t size) const {
    return at >= from && size <= bytes && at - from <= bytes - size;
  }
};

// Why a pointer of a descriptor (that passed check_law) is invalid; nullptr = all are valid.
const char* check_pointers(const LitheLaw& law, const Range& image) {
  const auto step = std::bit_cast<std::uint64_t>(law.step);
  if (!image.holds(step, kCodeAlign) || step % kCodeAlign != 0) return "its step lies outside its slot";
  const auto init = std::bit_cast<std::uint64_t>(law.init);
  if (init != 0 && (!image.holds(init, kCodeAlign) || init % kCodeAlign != 0)) return "its init lies outside its slot";
  const auto defaults = std::bit_cast<std::uint64_t>(law.state_defaults);
  if (law.state_size > 0 && !image.holds(defaults, law.state_size)) return "its State's defaults lie outside its slot";
  return nullptr;
}

}  // namespace

bool ArenaStore::in_use(std::uint32_t slot) const {
  return std::find(slots_.begin(), slots_.end(), slot) != slots_.end();
}

StageResult ArenaStore::load(std::uint32_t index, const wire::StageRequest& request, const LitheLaw*& law,
                             std::span<char> why) {
  const auto refuse = [&](StageResult result, const char* words) {
    std::snprintf(why.data(), why.size(), "arena slot %u: %s", request.slot, words);
    return result;
  };
  if (index >= slots_.size() || slots_[index] != 0) return refuse(StageResult::slots_full, "no room for another law");
  if (!arena::is_slot(request.slot)) return refuse(StageResult::hostile, "there is no such slot");
  if (in_use(request.slot)) return refuse(StageResult::hostile, "another law in memory has its code there");
  const Range image{arena::slot_address(request.slot), request.code_bytes};
  if (image.bytes > arena::kSlotBytes) return refuse(StageResult::hostile, "the image is larger than a slot");
  if (!image.holds(request.entry, sizeof(LitheLaw)) || request.entry % alignof(LitheLaw) != 0)
    return refuse(StageResult::hostile, "the law's descriptor lies outside the image");
  if (arena::image_hash(arena_.slot(request.slot).first(request.code_bytes)) != request.image_hash) {
    return refuse(
        StageResult::image_damaged,
        "it does not hold the image that was announced, or one linked for other functions than this Spine has");
  }
  serialise_core();  // this thread makes the first call, and the slot may have held another law
  law = reinterpret_cast<const LitheLaw*>(request.entry);
  // An invalid descriptor is refused by the Loader with more detail; its pointers are not checked here.
  const char* reason = law::check_law(*law) == nullptr ? check_pointers(*law, image) : nullptr;
  if (reason != nullptr) return refuse(StageResult::hostile, reason);
  slots_[index] = request.slot;
  return StageResult::staged;
}

void ArenaStore::unload(std::uint32_t index) {
  if (index < slots_.size()) slots_[index] = 0;
}

}  // namespace lithe::load
