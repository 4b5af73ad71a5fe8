// SPDX-License-Identifier: Apache-2.0
// Where a law failed, for the one who wrote it.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

namespace lithe::lawd {

// {"ok", "line", "function"} of an address in `program`, which was linked with its lines: the innermost line that the
// law's author wrote, looking through what was inlined.
// Contract: some milliseconds (addr2line)
nlohmann::json own_place(const std::string& program, std::uint64_t address);

}  // namespace lithe::lawd
