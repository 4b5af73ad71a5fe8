// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/admission_elf.hpp"

#include <cxxabi.h>
#include <elf.h>

#include <cstdlib>
#include <cstring>

namespace lithe::lawd {
namespace {

#if defined(__x86_64__)
constexpr std::uint16_t kMachine = EM_X86_64;
#else
constexpr std::uint16_t kMachine = EM_AARCH64;
#endif
constexpr std::size_t kMaxSections = 4096, kMaxSymbols = 65536, kMaxRelocations = 262144;

template <class T>
bool read_at(std::string_view bytes, std::uint64_t offset, T& out) {
  if (offset > bytes.size() || bytes.size() - offset < sizeof(T)) return false;
  std::memcpy(&out, bytes.data() + offset, sizeof(T));
  return true;
}

std::optional<std::string_view> part(std::string_view bytes, std::uint64_t offset, std::uint64_t size) {
  if (offset > bytes.size() || bytes.size() - offset < size) return std::nullopt;
  return bytes.substr(offset, size);
}

// A zero-terminated name inside a string table; empty when it is not inside.
std::string_view name_at(std::string_view table, std::uint64_t offset) {
  if (offset >= table.size()) return "";
  const std::string_view rest = table.substr(offset);
  const std::size_t end = rest.find('\0');
  return end == std::string_view::npos ? "" : rest.substr(0, end);
}

class Parser {
 public:
  Parser(std::string_view bytes, ElfObject& out) : bytes_(bytes), out_(out) {}

  // The error, or "".
  std::string_view parse() {
    if (const std::string_view why = header(); !why.empty()) return why;
    if (!read_sections()) return "its section table points outside the file";
    if (!read_symbols()) return "its symbol table is damaged";
    if (!read_relocations()) return "its relocations are damaged";
    return "";
  }

 private:
  std::string_view header() {
    if (!read_at(bytes_, 0, header_) || std::memcmp(header_.e_ident, ELFMAG, SELFMAG) != 0)
      return "it is not an ELF file";
    const bool ours = header_.e_ident[EI_CLASS] == ELFCLASS64 && header_.e_ident[EI_DATA] == ELFDATA2LSB &&
                      header_.e_machine == kMachine;
    if (!ours) return "it was compiled for another machine";
    if (header_.e_type != ET_REL) return "it is not a relocatable object";
    const bool plain = header_.e_shentsize == sizeof(Elf64_Shdr) && header_.e_shnum > 0 &&
                       header_.e_shnum <= kMaxSections && header_.e_shstrndx < header_.e_shnum;
    if (!plain) return "it has no usable section table";
    out_.machine = header_.e_machine;
    return "";
  }

  bool read_sections() {
    raw_.resize(header_.e_shnum);
    for (std::size_t i = 0; i < raw_.size(); ++i) {
      if (!read_at(bytes_, header_.e_shoff + i * sizeof(Elf64_Shdr), raw_[i])) return false;
    }
    const Elf64_Shdr& names = raw_[header_.e_shstrndx];
    const auto table = part(bytes_, names.sh_offset, names.sh_size);
    if (!table) return false;
    for (const Elf64_Shdr& raw : raw_) {
      ElfSection section{name_at(*table, raw.sh_name), raw.sh_type, raw.sh_flags, raw.sh_size, {}, 0};
      if (raw.sh_type != SHT_NOBITS && raw.sh_type != SHT_NULL) {
        const auto bytes = part(bytes_, raw.sh_offset, raw.sh_size);
        if (!bytes) return false;
        section.bytes = *bytes;
      }
      if (raw.sh_type == SHT_RELA || raw.sh_type == SHT_REL) section.applies_to = raw.sh_info;
      out_.sections.push_back(section);
    }
    return true;
  }

  bool read_symbols() {
    for (std::size_t i = 0; i < raw_.size(); ++i) {
      if (raw_[i].sh_type != SHT_SYMTAB) continue;
      if (!out_.symbols.empty() || raw_[i].sh_link >= raw_.size()) return false;  // a second symbol table
      const std::string_view table = out_.sections[i].bytes, names = out_.sections[raw_[i].sh_link].bytes;
      const std::size_t count = table.size() / sizeof(Elf64_Sym);
      if (count > kMaxSymbols || raw_[i].sh_entsize != sizeof(Elf64_Sym)) return false;
      for (std::size_t k = 0; k < count; ++k) {
        Elf64_Sym raw;
        if (!read_at(table, k * sizeof raw, raw)) return false;
        if (raw.st_shndx == SHN_XINDEX) return false;
        out_.symbols.push_back({name_at(names, raw.st_name), raw.st_value, raw.st_size, raw.st_shndx,
                                static_cast<std::uint8_t>(ELF64_ST_TYPE(raw.st_info)),
                                static_cast<std::uint8_t>(ELF64_ST_BIND(raw.st_info)),
                                static_cast<std::uint8_t>(ELF64_ST_VISIBILITY(raw.st_other))});
      }
    }
    return !out_.symbols.empty();
  }

  bool read_relocations() {
    for (const ElfSection& section : out_.sections) {
      if (section.type == SHT_REL) return false;  // neither machine uses them
      if (section.type != SHT_RELA) continue;
      if (section.applies_to >= out_.sections.size()) return false;
      const std::size_t count = section.bytes.size() / sizeof(Elf64_Rela);
      if (count + out_.relocations.size() > kMaxRelocations) return false;
      for (std::size_t k = 0; k < count; ++k) {
        Elf64_Rela raw;
        if (!read_at(section.bytes, k * sizeof raw, raw)) return false;
        const auto symbol = static_cast<std::uint32_t>(ELF64_R_SYM(raw.r_info));
        if (symbol >= out_.symbols.size() || raw.r_offset >= out_.sections[section.applies_to].size) return false;
        out_.relocations.push_back({section.applies_to, raw.r_offset,
                                    static_cast<std::uint32_t>(ELF64_R_TYPE(raw.r_info)), symbol, raw.r_addend});
      }
    }
    return true;
  }

  std::string_view bytes_;
  ElfObject& out_;
  Elf64_Ehdr header_{};
  std::vector<Elf64_Shdr> raw_;
};

}  // namespace

std::string readable(std::string_view symbol) {
  if (!symbol.starts_with("_Z")) return std::string(symbol);  // "f" alone would be read as the type float
  int status = 0;
  char* text = abi::__cxa_demangle(std::string(symbol).c_str(), nullptr, nullptr, &status);
  std::string name = status == 0 ? text : std::string(symbol);
  std::free(text);
  return name;
}

std::optional<ElfObject> ElfObject::parse(std::string_view bytes, std::string& why) {
  ElfObject object;
  why = Parser(bytes, object).parse();
  if (!why.empty()) return std::nullopt;
  return object;
}

}  // namespace lithe::lawd
