// SPDX-License-Identifier: Apache-2.0
// The functions that a law may call, and their stubs. A law that calls any other function cannot be linked, so no
// undefined symbol reaches the Spine.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "spine/arena/layout.hpp"

namespace lithe::arena {

struct Veneer {
  std::string_view name;  // as the linker knows it
  void (*function)();     // in this process; never called through this type
};

// In the order of the stubs.
std::span<const Veneer> veneers();

// Address of the stub of the i-th veneer, the same in every process.
inline constexpr std::uint64_t kVeneerBytes = 16;
constexpr std::uint64_t veneer_address(std::size_t i) { return kStubs + i * kVeneerBytes; }

// The stack protector's guard word on machines that keep it in memory: a zero on the stub page.
inline constexpr std::uint64_t kGuardWord = kStubs + kStubBytes - 64;

// FNV-1a of the names in their order.
std::uint64_t veneers_hash();

// Writes every stub of this process. `page` is kStubBytes long and zero.
void write_stubs(std::span<std::byte> page);

}  // namespace lithe::arena
