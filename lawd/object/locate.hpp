// SPDX-License-Identifier: Apache-2.0
// Finds the source line where a law failed.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>

namespace lithe::lawd {

// {"ok", "line", "function"} of an address in `program`, which was linked with its lines: the innermost line of the
// law's source, also for inlined code.
// Contract: some milliseconds (addr2line)
nlohmann::json own_place(const std::string& program, std::uint64_t address);

}  // namespace lithe::lawd
