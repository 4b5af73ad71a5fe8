// SPDX-License-Identifier: Apache-2.0
// Links an admitted law for one slot of the arena: pure work on files. The Service writes what comes out into the slot.
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "lawd/compile/toolchain.hpp"

namespace lithe::lawd {

// A law linked for its slot.
struct Linked {
  std::vector<std::byte> bytes;  // from the slot's start
  std::uint64_t entry = 0;       // address of the law's descriptor
  std::uint64_t hash = 0;        // arena::image_hash
};

// Why a relocatable object cannot be placed: it has writable data, or code that runs at load time. One sentence with
// the name; empty = it can.
// Contract: any bytes are safe
std::string why_not_placeable(std::string_view object);

// The law in `object`, a file whose bytes are the second argument, linked for `slot`; or the refusal, as the Service
// answers it. `scratch`: folder for the linker's files.
std::variant<Linked, nlohmann::json> link_for_slot(const Toolchain& toolchain, const std::string& scratch,
                                                   const std::string& object, std::string_view bytes,
                                                   std::uint32_t slot);

// {"ok", "line", "function"} of the code at this offset [bytes] from the start of a slot with the law in `object`: the
// innermost line of the law's source, also for inlined code. Links once.
nlohmann::json line_in_slot(const Toolchain& toolchain, const std::string& scratch, const std::string& object,
                            std::uint32_t offset);

}  // namespace lithe::lawd
