// SPDX-License-Identifier: Apache-2.0
// Finds the source line of a place in the object.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "lawd/core/admission.hpp"
#include "lawd/run/child.hpp"

namespace lithe::lawd {

// Runs a program with its stdout captured. The output is complete, or the Outcome is not clean().
Outcome output_of(const std::vector<std::string>& argv, int wall_ms = 5'000);

// Contract: no work before the first call; each call takes a few milliseconds (addr2line)
class SourceLines {
 public:
  explicit SourceLines(const Compiled& compiled) : compiled_(compiled) {}

  // The law's line of the code at `offset` of a section, also for inlined code; 0 = not known.
  int of(std::string_view section, std::uint64_t offset) const;

  // The first line that contains the last word of a (demangled) name, outside comments; 0 = none.
  int mentions(std::string_view name) const;

  // The last line that is not only a comment; 1 when there is none.
  int last() const;

  // The line in the compiler's "path:line:column" when the path is the law's, else 0.
  int own_line(std::string_view place) const;

 private:
  const Compiled& compiled_;
};

}  // namespace lithe::lawd
