// SPDX-License-Identifier: Apache-2.0
// Finds the source line of a place in the object.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "lawd/core/admission.hpp"

namespace lithe::lawd {

// {"ok", "line", "function"} of an address in `program`, which has its lines: the innermost line of the law's source,
// also for inlined code. Of an object, `section` says in which section the address is.
// Contract: some milliseconds (addr2line)
nlohmann::json own_place(const std::string& program, std::uint64_t address, std::string_view section = "");

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

// Checks the instructions of a law. Refused: those that enter the kernel, switch the containment off, or give a
// different result on each call.

void check_code(const Compiled& compiled, const SourceLines& lines, Admission& out);

// Why a law may not have an instruction (as objdump names it); empty when it may.
std::string_view why_instruction_is_refused(std::string_view mnemonic);

// Bounds a law's stack depth, from the call graph that the compiler wrote.

void check_stack(const Compiled& compiled, const SourceLines& lines, Admission& out);

}  // namespace lithe::lawd
