// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/admission_elf.hpp"

#include <gelf.h>

namespace lithe::lawd {
namespace {

#if defined(__x86_64__)
constexpr std::uint16_t kMachine = EM_X86_64;
#else
constexpr std::uint16_t kMachine = EM_AARCH64;
#endif
// Local symbols that are in no source and name nothing: AArch64 marks where code and data begin ($x, $d), and where the
// variables of a section are counted from (.LANCHOR0).
bool is_mark(const GElf_Sym& symbol, std::string_view name) {
  return GELF_ST_BIND(symbol.st_info) == STB_LOCAL && (name.starts_with('$') || name.starts_with('.'));
}

constexpr std::size_t kMaxSections = 4096, kMaxSymbols = 65536, kMaxRelocations = 262144;

class Parser {
 public:
  Parser(Elf* elf, ElfObject& out) : elf_(elf), out_(out) {}

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
    GElf_Ehdr head;
    if (elf_kind(elf_) != ELF_K_ELF || gelf_getehdr(elf_, &head) == nullptr) return "it is not an ELF file";
    const bool ours =
        head.e_ident[EI_CLASS] == ELFCLASS64 && head.e_ident[EI_DATA] == ELFDATA2LSB && head.e_machine == kMachine;
    if (!ours) return "it was compiled for another machine";
    if (head.e_type != ET_REL) return "it is not a relocatable object";
    if (elf_getshdrnum(elf_, &count_) != 0 || elf_getshdrstrndx(elf_, &names_) != 0 || count_ == 0 ||
        count_ > kMaxSections || names_ >= count_) {
      return "it has no usable section table";
    }
    return "";
  }

  std::string_view name(std::size_t table, std::size_t offset) const {
    const char* text = elf_strptr(elf_, table, offset);
    return text == nullptr ? "" : text;
  }

  bool read_sections() {
    for (std::size_t i = 0; i < count_; ++i) {
      Elf_Scn* section = elf_getscn(elf_, i);
      GElf_Shdr raw;
      if (gelf_getshdr(section, &raw) == nullptr) return false;
      const bool in_file = raw.sh_type != SHT_NOBITS && raw.sh_type != SHT_NULL;
      const Elf_Data* data = in_file ? elf_rawdata(section, nullptr) : nullptr;
      if (in_file && (data == nullptr || data->d_size != raw.sh_size)) return false;
      const bool links = raw.sh_type == SHT_RELA || raw.sh_type == SHT_REL;
      out_.sections.push_back({name(names_, raw.sh_name), raw.sh_type, raw.sh_flags, raw.sh_size,
                               in_file ? std::string_view(static_cast<char*>(data->d_buf), data->d_size) : "",
                               links ? raw.sh_info : 0});
    }
    return true;
  }

  bool read_symbols() {
    for (std::size_t i = 0; i < count_; ++i) {
      if (out_.sections[i].type != SHT_SYMTAB) continue;
      GElf_Shdr table;
      Elf_Scn* section = elf_getscn(elf_, i);
      Elf_Data* data = elf_getdata(section, nullptr);
      if (!out_.symbols.empty() || data == nullptr || gelf_getshdr(section, &table) == nullptr) return false;
      if (table.sh_entsize != sizeof(Elf64_Sym) || table.sh_size / sizeof(Elf64_Sym) > kMaxSymbols) return false;
      GElf_Sym raw;
      for (int k = 0; gelf_getsym(data, k, &raw) != nullptr; ++k) {
        if (raw.st_shndx == SHN_XINDEX) return false;
        const std::string_view text = name(table.sh_link, raw.st_name);
        out_.symbols.push_back({is_mark(raw, text) ? "" : text, raw.st_value, raw.st_size, raw.st_shndx,
                                static_cast<std::uint8_t>(GELF_ST_TYPE(raw.st_info)),
                                static_cast<std::uint8_t>(GELF_ST_BIND(raw.st_info)),
                                static_cast<std::uint8_t>(GELF_ST_VISIBILITY(raw.st_other))});
      }
    }
    return !out_.symbols.empty();
  }

  bool read_relocations() {
    for (std::size_t i = 0; i < count_; ++i) {
      const ElfSection& section = out_.sections[i];
      if (section.type == SHT_REL) return false;  // neither machine uses them
      if (section.type != SHT_RELA) continue;
      Elf_Data* data = elf_getdata(elf_getscn(elf_, i), nullptr);
      if (data == nullptr || section.applies_to >= out_.sections.size()) return false;
      if (section.size / sizeof(Elf64_Rela) + out_.relocations.size() > kMaxRelocations) return false;
      GElf_Rela raw;
      for (int k = 0; gelf_getrela(data, k, &raw) != nullptr; ++k) {
        const auto symbol = static_cast<std::uint32_t>(GELF_R_SYM(raw.r_info));
        if (symbol >= out_.symbols.size() || raw.r_offset >= out_.sections[section.applies_to].size) return false;
        out_.relocations.push_back(
            {section.applies_to, raw.r_offset, static_cast<std::uint32_t>(GELF_R_TYPE(raw.r_info)), symbol});
      }
    }
    return true;
  }

  Elf* elf_;
  ElfObject& out_;
  std::size_t count_ = 0, names_ = 0;
};

}  // namespace

ElfHandle open_elf(std::string_view bytes) {
  elf_version(EV_CURRENT);
  return {elf_memory(const_cast<char*>(bytes.data()), bytes.size()), &elf_end};  // opened to be read only
}

std::optional<ElfObject> ElfObject::parse(std::string_view bytes, std::string& why) {
  ElfObject object;
  object.elf = open_elf(bytes);
  why = Parser(object.elf.get(), object).parse();
  if (!why.empty()) return std::nullopt;
  return object;
}

}  // namespace lithe::lawd
