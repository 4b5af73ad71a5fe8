// SPDX-License-Identifier: Apache-2.0
// Addresses of the code arena: the same numbers in every process, so that a law linked once runs in all of them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace lithe::arena {

#if defined(__has_feature)
#define LITHE_ARENA_HAS(feature) __has_feature(feature)
#else
#define LITHE_ARENA_HAS(feature) 0
#endif

// Far from the kernel's own choice of addresses, and within the 39 address bits of small ARM kernels. With
// AddressSanitizer another address is used, because its shadow is here.
#if defined(__SANITIZE_ADDRESS__) || LITHE_ARENA_HAS(address_sanitizer)
inline constexpr std::uint64_t kBase = 0x2000'0000'0000;
#else
inline constexpr std::uint64_t kBase = 0x30'0000'0000;
#endif
#undef LITHE_ARENA_HAS

inline constexpr std::uint32_t kSlots = 16;
inline constexpr std::uint32_t kSlotBytes = 256u << 10;  // a multiple of every page size Linux has
inline constexpr std::uint64_t kBytes = std::uint64_t{kSlots} * kSlotBytes;

// The stubs lie directly below the slots, on pages that belong to the process alone.
inline constexpr std::uint64_t kStubBytes = 64u << 10;  // one page of the largest size
inline constexpr std::uint64_t kStubs = kBase - kStubBytes;

// The descriptor by which the arena is handed to a child process.
inline constexpr int kHandedFd = 3;

// Slots are counted from 1; 0 means none.
constexpr bool is_slot(std::uint32_t slot) { return slot >= 1 && slot <= kSlots; }
constexpr std::uint64_t slot_address(std::uint32_t slot) { return kBase + std::uint64_t{slot - 1} * kSlotBytes; }

// FNV-1a of an image, begun with the hash of the veneers it was linked against: so an image linked against another list
// of functions never has a valid hash.
// Contract: allocates nothing
std::uint64_t image_hash(std::span<const std::byte> image);

}  // namespace lithe::arena
