// SPDX-License-Identifier: Apache-2.0
// The rules for a law's object: its sections, imported and exported symbols.
#include <algorithm>
#include <array>
#include <cstring>

#include "lawd/core/admission.hpp"
#include "lawd/object/admission_elf.hpp"
#include "lawd/object/admission_lines.hpp"
#include "lawd/run/child.hpp"
#include "lawd/run/files.hpp"
#include "lawd/source/admission_words.hpp"
#include "spine/core/lookup.hpp"
#include "spine/law/resident.hpp"

namespace lithe::lawd {
namespace {

constexpr std::uint64_t kMaxTextBytes = 128u << 10, kMaxConstantBytes = 64u << 10;

bool in_memory(const ElfSection& section) { return (section.flags & SHF_ALLOC) != 0 && section.size > 0; }
bool is_code(const ElfSection& section) { return in_memory(section) && (section.flags & SHF_EXECINSTR) != 0; }

bool is_or_begins(std::string_view name, std::string_view wanted) {
  return name == wanted || (name.starts_with(wanted) && name[wanted.size()] == '.');
}

// Constants that contain addresses: written once by the loader, never by the law.
bool is_relro(std::string_view name) { return is_or_begins(name, ".data.rel.ro"); }

bool is_known_section(const ElfSection& section) {
  if (is_code(section)) return is_or_begins(section.name, ".text") && (section.flags & SHF_WRITE) == 0;
  if ((section.flags & SHF_WRITE) != 0) return is_relro(section.name) && section.type == SHT_PROGBITS;
  return is_or_begins(section.name, ".rodata") || section.name.starts_with(".note") || section.name == ".eh_frame";
}

struct LinkKinds {
  std::array<std::uint32_t, 24> kinds;
  bool has(std::uint32_t kind) const { return contains(kinds, kind); }
};

// Relocations that a linker resolves completely, in code and constants. Those of thread-local data and indirect
// functions are not in the list.
const LinkKinds& link_kinds() {
#if defined(__x86_64__)
  static constexpr LinkKinds kAll{{R_X86_64_64, R_X86_64_PC32, R_X86_64_PLT32, R_X86_64_GOTPCREL, R_X86_64_GOTPCRELX,
                                   R_X86_64_REX_GOTPCRELX, R_X86_64_PC64, R_X86_64_GOTPC32}};
#else
  static constexpr LinkKinds kAll{{R_AARCH64_ABS64, R_AARCH64_PREL32, R_AARCH64_PREL64, R_AARCH64_CALL26,
                                   R_AARCH64_JUMP26, R_AARCH64_CONDBR19, R_AARCH64_TSTBR14, R_AARCH64_ADR_PREL_LO21,
                                   R_AARCH64_ADR_PREL_PG_HI21, R_AARCH64_ADD_ABS_LO12_NC, R_AARCH64_LDST8_ABS_LO12_NC,
                                   R_AARCH64_LDST16_ABS_LO12_NC, R_AARCH64_LDST32_ABS_LO12_NC,
                                   R_AARCH64_LDST64_ABS_LO12_NC, R_AARCH64_LDST128_ABS_LO12_NC, R_AARCH64_ADR_GOT_PAGE,
                                   R_AARCH64_LD64_GOT_LO12_NC, R_AARCH64_LD64_GOTPAGE_LO15}};
#endif
  return kAll;
}

class Object {
 public:
  Object(const ElfObject& elf, const SourceLines& lines, Admission& out) : elf_(elf), lines_(lines), out_(out) {}

  void check() {
    gate("memory", [this] { check_memory(); });
    gate("calls", [this] { check_undefined(); });
    gate("exports", [this] { check_exports(); });
    gate("links", [this] { check_relocations(); });
    gate("descriptor", [this] { check_descriptor(); });
    gate("size", [this] { check_size(); });
  }

 private:
  template <class Body>
  void gate(const char* name, Body body) {
    gate_ = name;
    detail_.clear();
    out_.apply(name, [&] { return body(), detail_; });
  }
  void refuse(std::string message, int line = 0) { out_.refuse(gate_, std::move(message), line); }

  // The law's line that refers to a symbol; 0 = not known.
  int line_of_use(std::uint32_t symbol) const {
    for (const ElfRelocation& relocation : elf_.relocations) {
      const ElfSection& place = elf_.sections[relocation.section];
      if (relocation.symbol == symbol && is_code(place)) return lines_.of(place.name, relocation.offset);
    }
    return 0;
  }

  // Refuses writable data, code that runs at load time, and thread-local data; names the variable.
  void check_memory() {
    for (std::size_t i = 1; i < elf_.sections.size(); ++i) {
      const ElfSection& section = elf_.sections[i];
      if (!in_memory(section) || is_known_section(section)) continue;
      if ((section.flags & SHF_TLS) != 0) {
        name_variables(i, "is thread_local: a law has no memory but its State, move it there");
      } else if (section.type == SHT_INIT_ARRAY || section.type == SHT_FINI_ARRAY ||
                 section.type == SHT_PREINIT_ARRAY || is_or_begins(section.name, ".ctors") ||
                 is_or_begins(section.name, ".dtors") || is_or_begins(section.name, ".init") ||
                 is_or_begins(section.name, ".fini")) {
        refuse(
            "code that runs when the law is loaded or unloaded (a constructor, or a global that is computed at run "
            "time): make the value constexpr, or compute it in step()");
      } else if (is_or_begins(section.name, ".gcc_except_table")) {
        refuse("exception tables: a law has no exceptions, test the value, set a safe torque and return");
      } else if ((section.flags & SHF_WRITE) != 0) {
        name_variables(i, "is a variable outside State: move it to State, or make it constexpr when it never changes");
      } else {
        refuse("a section of its own, " + std::string(section.name) + ": remove the attribute that makes it");
      }
    }
    for (const ElfSymbol& symbol : elf_.symbols) {
      if (symbol.section == SHN_COMMON)
        refuse(readable(symbol.name) + " is a variable outside State: move it to State");
      if (symbol.type == STT_GNU_IFUNC)
        refuse(readable(symbol.name) + " is chosen when the law is loaded: call it directly");
      if (symbol.name.starts_with("_ZTV") || symbol.name.starts_with("_ZTI"))
        refuse(readable(symbol.name) + ": virtual functions and type information are not for laws: use a template");
    }
  }

  void name_variables(std::size_t section, const std::string& why) {
    bool named = false;
    for (std::uint32_t k = 0; k < elf_.symbols.size(); ++k) {
      const ElfSymbol& symbol = elf_.symbols[k];
      if (symbol.section != section || symbol.name.empty() || symbol.type == STT_SECTION) continue;
      named = true;
      const std::string name = readable(symbol.name);
      if (name.starts_with("guard variable for ")) continue;  // the guarded variable is reported itself
      const int line = lines_.mentions(name);
      const std::size_t local = name.rfind(")::");  // a variable inside a function: report its own name
      const std::string shown = local == std::string::npos ? name : name.substr(local + 3);
      refuse(shown + " " + why, line != 0 ? line : line_of_use(k));
    }
    if (!named) refuse("something in " + std::string(elf_.sections[section].name) + " " + why);
  }

  void check_undefined() {
    std::size_t count = 0;
    for (std::uint32_t k = 1; k < elf_.symbols.size(); ++k) {
      const ElfSymbol& symbol = elf_.symbols[k];
      if (symbol.section != SHN_UNDEF || symbol.name.empty()) continue;
      ++count;
      if (is_allowed_symbol(symbol.name)) continue;
      const std::string name = readable(symbol.name);
      refuse("the law uses " + name + ": " + why_symbol_is_refused(symbol.name, name), line_of_use(k));
    }
    detail_ = std::to_string(count) + " names used";
  }

  void check_exports() {
    for (const ElfSymbol& symbol : elf_.symbols) {
      const bool defined = symbol.section != SHN_UNDEF && symbol.section != SHN_ABS;
      const bool strong = symbol.binding != STB_LOCAL && symbol.binding != STB_WEAK && symbol.visibility == STV_DEFAULT;
      if (!defined || !strong || symbol.name == "lithe_law") continue;
      refuse(readable(symbol.name) +
             " is visible outside the law: a law exports its descriptor only, remove the attribute");
    }
  }

  void check_relocations() {
    for (const ElfRelocation& relocation : elf_.relocations) {
      const ElfSection& place = elf_.sections[relocation.section];
      if ((place.flags & SHF_ALLOC) == 0 || place.name == ".eh_frame" || link_kinds().has(relocation.type)) continue;
      return refuse("the object needs a kind of link (" + std::to_string(relocation.type) +
                        ") that laws may not have: no thread_local, no ifunc",
                    is_code(place) ? lines_.of(place.name, relocation.offset) : 0);
    }
  }

  void check_descriptor() {
    const auto found = std::ranges::find_if(elf_.symbols, [](const ElfSymbol& symbol) {
      return symbol.name == "lithe_law" && symbol.section != SHN_UNDEF && symbol.binding == STB_GLOBAL;
    });
    if (found == elf_.symbols.end())
      return refuse("the file exports no law: end it with LITHE_LAW(Type, \"name\");", lines_.last());
    const ElfSection* section = elf_.section(found->section);
    LitheLaw law;
    const bool whole = section != nullptr && found->type == STT_OBJECT && found->visibility == STV_DEFAULT &&
                       found->size == sizeof law && found->value <= section->bytes.size() &&
                       section->bytes.size() - found->value >= sizeof law && is_relro(section->name);
    if (!whole)
      return refuse("lithe_law is not a descriptor of this contract: use LITHE_LAW(Type, \"name\"); as it is");
    std::memcpy(&law, section->bytes.data() + found->value, sizeof law);
    if (!points_into(*found, offsetof(LitheLaw, step), true))
      return refuse("the descriptor's step is not a function of this law: use LITHE_LAW(Type, \"name\"); as it is");
    const bool has_init = is_linked(*found, offsetof(LitheLaw, init));
    if (has_init && !points_into(*found, offsetof(LitheLaw, init), true))
      return refuse("the descriptor's init is not a function of this law: use LITHE_LAW(Type, \"name\"); as it is");
    const bool defaults = points_into(*found, offsetof(LitheLaw, state_defaults), false);
    law.step = reinterpret_cast<decltype(law.step)>(std::uintptr_t{1});  // linked later: see points_into
    law.state_defaults = defaults || law.state_size == 0 ? &law : nullptr;
    char text[192];
    if (*law::describe_mismatch(law, text, sizeof text) != '\0') refuse(text);
    detail_ = "abi " + std::to_string(law.abi) + ", state " + std::to_string(law.state_size) + " bytes";
  }

  const ElfRelocation* link_at(const ElfSymbol& law, std::size_t offset) const {
    for (const ElfRelocation& relocation : elf_.relocations)
      if (relocation.section == law.section && relocation.offset == law.value + offset) return &relocation;
    return nullptr;
  }
  bool is_linked(const ElfSymbol& law, std::size_t offset) const { return link_at(law, offset) != nullptr; }

  // True when the pointer at `offset` of the descriptor points to code (or constants) in this object.
  bool points_into(const ElfSymbol& law, std::size_t offset, bool code) const {
    const ElfRelocation* link = link_at(law, offset);
    const ElfSection* target = link == nullptr ? nullptr : elf_.section(elf_.symbols[link->symbol].section);
    return target != nullptr && is_code(*target) == code;
  }

  void check_size() {
    std::uint64_t text = 0, constants = 0;
    for (const ElfSection& section : elf_.sections)
      if (in_memory(section)) (is_code(section) ? text : constants) += section.size;
    const auto kib = [](std::uint64_t bytes) { return std::to_string((bytes + 1023) / 1024) + " KiB"; };
    if (text > kMaxTextBytes) {
      refuse("the law has " + kib(text) + " of code; " + kib(kMaxTextBytes) +
             " fit: use loops instead of repetition, smaller matrices, fewer templates");
    }
    if (constants > kMaxConstantBytes) {
      refuse("the law has " + kib(constants) + " of constants; " + kib(kMaxConstantBytes) +
             " fit: shorten tables, interpolate, use float");
    }
    detail_ = std::to_string(text) + " bytes of code, " + std::to_string(constants) + " of constants";
  }

  const ElfObject& elf_;
  const SourceLines& lines_;
  Admission& out_;
  const char* gate_ = "";
  std::string detail_;
};

}  // namespace

void admit_object(const Compiled& compiled, Admission& out) {
  const std::string bytes = read_file(compiled.object_path).value_or("");
  std::string why;
  const auto elf = ElfObject::parse(bytes, why);
  if (!elf) return out.refuse("object", "the compiler's object cannot be read: " + why);
  const SourceLines lines(compiled);
  Object(*elf, lines, out).check();
  check_stack(compiled, lines, out);
  check_code(compiled, lines, out);
}

}  // namespace lithe::lawd
