// SPDX-License-Identifier: Apache-2.0
#include "lawd/object/link.hpp"

#include <fmt/format.h>
#include <gelf.h>

#include <algorithm>
#include <cstring>
#include <fstream>

#include "lawd/core/admission.hpp"
#include "lawd/object/admission_elf.hpp"
#include "lawd/object/admission_lines.hpp"
#include "lawd/run/child.hpp"
#include "lawd/run/files.hpp"
#include "spine/arena/arena.hpp"
#include "spine/arena/veneers.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

// The variable that a section belongs to; the section's name when no symbol is found.
std::string owner_of(const ElfObject& object, std::uint32_t section) {
  std::string name;
  for (const ElfSymbol& symbol : object.symbols) {
    if (symbol.section != section || symbol.type == STT_SECTION || symbol.name.empty()) continue;
    name = readable(symbol.name);
    if (!name.starts_with("guard variable")) return name;
  }
  return name.empty() ? std::string(object.sections[section].name) : name;
}

// Slots hold code and constants only: these sections of an object are kept, in this order.
std::string script_for(std::uint32_t slot) {
  std::string text = fmt::format(
      "ENTRY(lithe_law)\nSECTIONS {{\n  . = {:#x};\n  .text : {{ *(.text .text.*) }}\n"
      "  .rodata : {{ *(.rodata .rodata.*) *(.data.rel.ro .data.rel.ro.*) *(.got .got.plt) }}\n"
      "  /DISCARD/ : {{ *(.comment .note .note.* .eh_frame .eh_frame_hdr .gnu.*) }}\n}}\n",
      arena::slot_address(slot));
  for (std::size_t i = 0; i < arena::veneers().size(); ++i)
    text += fmt::format("PROVIDE({} = {:#x});\n", arena::veneers()[i].name, arena::veneer_address(i));
  return text + fmt::format("PROVIDE(__stack_chk_guard = {:#x});\n", arena::kGuardWord);
}

// The names behind "undefined reference to `...'".
std::string undefined_names(const std::string& words) {
  constexpr std::string_view kBefore = "undefined reference to `";
  std::vector<std::string> names;
  for (auto at = words.find(kBefore); at != std::string::npos; at = words.find(kBefore, at + 1)) {
    const auto from = at + kBefore.size();
    const std::string name = readable(words.substr(from, words.find('\'', from) - from));
    if (!contains(names, name)) names.push_back(name);
  }
  return joined(names);
}

// The linker's output as the bytes of the slot, or an error sentence when a section has a wrong address.
std::string read_linked(std::string_view elf, std::uint32_t slot, Linked& linked) {
  const ElfHandle program = open_elf(elf);
  GElf_Ehdr head;
  if (gelf_getehdr(program.get(), &head) == nullptr || head.e_type != ET_EXEC)
    return "the linker made something else than a program";
  const std::uint64_t base = arena::slot_address(slot);
  for (int i = 0; i < head.e_phnum; ++i) {
    GElf_Phdr segment;
    if (gelf_getphdr(program.get(), i, &segment) == nullptr) return "the linker's output is damaged";
    if (segment.p_type != PT_LOAD || segment.p_memsz == 0) continue;
    const std::uint64_t offset = segment.p_vaddr - base;
    if (segment.p_vaddr < base || offset > arena::kSlotBytes || segment.p_memsz > arena::kSlotBytes - offset)
      return fmt::format("its code and constants do not fit: a law may have {} KiB", arena::kSlotBytes / 1024);
    if (segment.p_filesz != segment.p_memsz) return "it has variables outside its State";
    if (segment.p_offset > elf.size() || segment.p_filesz > elf.size() - segment.p_offset)
      return "the file is cut short";
    linked.bytes.resize(std::max<std::size_t>(linked.bytes.size(), offset + segment.p_memsz));
    std::memcpy(linked.bytes.data() + offset, elf.data() + segment.p_offset, segment.p_filesz);
  }
  if (head.e_entry < base || head.e_entry - base >= linked.bytes.size())
    return "the file exports no law: end it with LITHE_LAW(Type, \"name\");";
  linked.entry = head.e_entry;
  linked.hash = arena::image_hash(linked.bytes);
  return "";
}

}  // namespace

std::string why_not_placeable(std::string_view object) {
  std::string why;
  const auto elf = ElfObject::parse(object, why);
  if (!elf) return why;
  for (std::uint32_t i = 1; i < elf->sections.size(); ++i) {
    const ElfSection& section = elf->sections[i];
    if ((section.flags & SHF_ALLOC) == 0 || (section.flags & SHF_WRITE) == 0 || section.size == 0) continue;
    if (section.name.starts_with(".data.rel.ro")) continue;  // constants that contain addresses
    const bool runs = section.type == SHT_INIT_ARRAY || section.type == SHT_FINI_ARRAY ||
                      section.type == SHT_PREINIT_ARRAY || section.name.starts_with(".ctors");
    if (runs) return "a variable of the law is set up by code that runs at start: make it constexpr";
    return "the variable " + owner_of(*elf, i) + " can be written: put it into State, or make it constexpr";
  }
  for (const ElfSymbol& symbol : elf->symbols) {
    if (symbol.section != SHN_COMMON) continue;
    return "the variable " + readable(symbol.name) + " can be written: put it into State, or make it constexpr";
  }
  return "";
}

std::variant<Linked, json> link_for_slot(const Toolchain& toolchain, const std::string& scratch,
                                         const std::string& object, std::string_view bytes, std::uint32_t slot) {
  if (const std::string why = why_not_placeable(bytes); !why.empty()) return refuse("place", why);
  const ScratchDir folder(scratch);
  const std::string script = folder.path() + "/slot.ld", program = folder.path() + "/law";
  if (!(std::ofstream(script) << script_for(slot)).flush())
    return refuse("cache", "cannot write into " + scratch + ": " + folder.error());
  const Outcome outcome = run_program(toolchain.place_command(object, script, program), Limits{});
  if (outcome.starved) return refuse_starved(starved_text("the linker", outcome));
  if (const std::string names = undefined_names(outcome.output); !names.empty()) {
    return refuse("place", "the law uses " + names +
                               ", which it does not define: a law may use itself, the contract and <cmath> only");
  }
  if (!outcome.clean()) return refuse("place", "the link failed: " + outcome.output);
  const auto elf = read_file(program);
  if (!elf) return refuse("cache", "cannot read back " + program);
  Linked linked;
  if (const std::string why = read_linked(*elf, slot, linked); !why.empty()) return refuse("place", why);
  return linked;
}

json line_in_slot(const Toolchain& toolchain, const std::string& scratch, const std::string& object,
                  std::uint32_t offset) {
  const ScratchDir folder(scratch);
  const std::string script = folder.path() + "/slot.ld", program = folder.path() + "/law";
  if (!(std::ofstream(script) << script_for(1)).flush())
    return refuse("cache", "cannot write into " + scratch + ": " + folder.error());
  const auto command = toolchain.place_command(object, script, program, Toolchain::Lines::kept);
  if (const Outcome linked = run_program(command, Limits{}); !linked.clean())
    return refuse("locate", "the link failed: " + linked.output);
  return own_place(program, arena::slot_address(1) + offset);
}

}  // namespace lithe::lawd
