// SPDX-License-Identifier: Apache-2.0
// Finds the pages of the program's own variables and makes them read-only.
#include <elf.h>
#include <link.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>

#include "spine/contain/memory/constants.hpp"

namespace lithe::contain {
namespace {

struct Program {
  std::uintptr_t from = UINTPTR_MAX, to = 0;  // of all writable segments
  bool bound_at_start = false;                // otherwise the first call of each library function writes a table
};

bool is_bound_at_start(const ElfW(Dyn) * entry) {
  for (; entry->d_tag != DT_NULL; ++entry) {
    const auto value = static_cast<std::uint64_t>(entry->d_un.d_val);
    if (entry->d_tag == DT_BIND_NOW || (entry->d_tag == DT_FLAGS && (value & DF_BIND_NOW) != 0) ||
        (entry->d_tag == DT_FLAGS_1 && (value & DF_1_NOW) != 0)) {
      return true;
    }
  }
  return false;
}

// The program itself is the first entry of the dynamic linker's list.
[[maybe_unused]] int read_program(dl_phdr_info* info, std::size_t, void* out) {
  auto& program = *static_cast<Program*>(out);
  for (int i = 0; i < info->dlpi_phnum; ++i) {
    const ElfW(Phdr) & header = info->dlpi_phdr[i];
    const std::uintptr_t from = info->dlpi_addr + header.p_vaddr;
    if (header.p_type == PT_DYNAMIC)
      program.bound_at_start = is_bound_at_start(reinterpret_cast<const ElfW(Dyn)*>(from));
    if (header.p_type != PT_LOAD || (header.p_flags & PF_W) == 0) continue;
    if (from < program.from) program.from = from;
    if (from + header.p_memsz > program.to) program.to = from + header.p_memsz;
  }
  return 1;
}

}  // namespace

Result<SealedStatics> SealedStatics::seal() {
#ifdef LITHE_SANITIZED
  return Error{"a sanitizer writes variables of its own all the time"};
#else
  Program program;
  dl_iterate_phdr(&read_program, &program);
  if (program.from >= program.to) return Error{"the program's variables were not found"};
  if (!program.bound_at_start) return Error{"the program is not linked with -z now"};
  const auto page = static_cast<std::uintptr_t>(sysconf(_SC_PAGESIZE));
  const std::uintptr_t from = program.from / page * page, to = (program.to + page - 1) / page * page;
  auto* first = reinterpret_cast<void*>(from);
  if (mprotect(first, to - from, PROT_READ) != 0) {
    const std::string why = std::strerror(errno);
    mprotect(first, to - from, PROT_READ | PROT_WRITE);  // some pages may be read-only already
    return Error{why};
  }
  return SealedStatics(first, to - from);
#endif
}

SealedStatics::SealedStatics(SealedStatics&& other) noexcept
    : from_(std::exchange(other.from_, nullptr)), bytes_(other.bytes_) {}

// Pages that the dynamic linker had made read-only stay read-only.
SealedStatics::~SealedStatics() {
  if (from_ != nullptr) mprotect(from_, bytes_, PROT_READ | PROT_WRITE);
}

}  // namespace lithe::contain
