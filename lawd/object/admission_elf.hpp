// SPDX-License-Identifier: Apache-2.0
// Reads an untrusted relocatable ELF object, with libelf.
#pragma once

#include <libelf.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace lithe::lawd {

// A file in memory, for libelf; `bytes` must outlive it.
using ElfHandle = std::unique_ptr<Elf, decltype(&elf_end)>;
ElfHandle open_elf(std::string_view bytes);

struct ElfSection {
  std::string_view name;
  std::uint32_t type = 0;
  std::uint64_t flags = 0;
  std::uint64_t size = 0;        // in memory
  std::string_view bytes;        // in the file; empty for .bss
  std::uint32_t applies_to = 0;  // of a relocation section: which section it changes
};

struct ElfSymbol {
  std::string_view name;
  std::uint64_t value = 0, size = 0;
  std::uint32_t section = 0;  // index; 0 = undefined, 0xfff1 absolute, 0xfff2 common
  std::uint8_t type = 0, binding = 0, visibility = 0;
};

struct ElfRelocation {
  std::uint32_t section = 0;  // it changes this section, at `offset`
  std::uint64_t offset = 0;
  std::uint32_t type = 0;
  std::uint32_t symbol = 0;  // index into symbols
};

// Views into `bytes`, which must outlive it.
// Contract: any bytes are safe
struct ElfObject {
  ElfHandle elf{nullptr, &elf_end};  // the views may point into it
  std::vector<ElfSection> sections;
  std::vector<ElfSymbol> symbols;
  std::vector<ElfRelocation> relocations;

  // Empty when the bytes are not a complete relocatable object of this machine; `why` gets the reason.
  static std::optional<ElfObject> parse(std::string_view bytes, std::string& why);

  const ElfSection* section(std::uint32_t index) const {
    return index != 0 && index < sections.size() ? &sections[index] : nullptr;
  }
};

}  // namespace lithe::lawd
