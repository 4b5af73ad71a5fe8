// SPDX-License-Identifier: Apache-2.0
// From a place in the object back to the line its author wrote.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "lawd/core/admission.hpp"
#include "lawd/run/child.hpp"

namespace lithe::lawd {

// Runs a program with its stdout captured. All of it, or not clean().
Outcome output_of(const std::vector<std::string>& argv, int wall_ms = 5'000);

// Contract: costs nothing until it is asked; then a few milliseconds (addr2line) per question
class SourceLines {
 public:
  explicit SourceLines(const Compiled& compiled) : compiled_(compiled) {}

  // The law's line that the code at `offset` of a section comes from, looking through what was inlined; 0 = not known.
  int of(std::string_view section, std::uint64_t offset) const;

  // The first line that has the last word of a (demangled) name, outside comments; 0 = none.
  int mentions(std::string_view name) const;

  // The last line that holds anything but a comment; 1 when none does.
  int last() const;

  // "path:line:column" as the compiler writes it: the line when the path is the law's, else 0.
  int own_line(std::string_view place) const;

 private:
  const Compiled& compiled_;
};

}  // namespace lithe::lawd
