// SPDX-License-Identifier: Apache-2.0
#include "spine/load/law_store.hpp"

#include <dlfcn.h>
#include <elf.h>
#include <fcntl.h>
#include <link.h>
#include <sys/stat.h>
#include <unistd.h>

#include <bit>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "spine/core/host/fd.hpp"

namespace lithe::load {
namespace {

constexpr off_t kMaxObjectBytes = off_t{64} << 20;
constexpr std::size_t kMaxSegments = 32;
#if defined(__x86_64__)
constexpr Elf64_Half kMachine = EM_X86_64;
#elif defined(__aarch64__)
constexpr Elf64_Half kMachine = EM_AARCH64;
#endif

bool fits(std::uint64_t offset, std::uint64_t bytes, std::uint64_t size) {
  return offset <= size && bytes <= size - offset;
}

const char* check_segments(int fd, const Elf64_Ehdr& head, std::uint64_t size) {
  std::array<Elf64_Phdr, kMaxSegments> segments;
  const std::size_t bytes = sizeof(Elf64_Phdr) * head.e_phnum;
  if (head.e_phentsize != sizeof(Elf64_Phdr) || head.e_phnum == 0 || head.e_phnum > kMaxSegments ||
      !fits(head.e_phoff, bytes, size)) {
    return "damaged object: its program headers are not at the given offset";
  }
  if (pread(fd, segments.data(), bytes, static_cast<off_t>(head.e_phoff)) != static_cast<ssize_t>(bytes))
    return "damaged object: cannot read its program headers";
  for (std::size_t i = 0; i < head.e_phnum; ++i) {
    const Elf64_Phdr& segment = segments[i];
    if (!fits(segment.p_offset, segment.p_filesz, size)) return "damaged object: the file is cut short";
    if (segment.p_type == PT_LOAD && segment.p_memsz > static_cast<std::uint64_t>(kMaxObjectBytes))
      return "damaged object: a segment is larger than 64 MiB";
  }
  return nullptr;
}

// Reads one byte of every page of the object, so that no tick has a page fault there.
void touch_pages(const void* inside) {
  Dl_info info{};
  if (dladdr(inside, &info) == 0 || info.dli_fbase == nullptr) return;
  const auto* base = static_cast<const char*>(info.dli_fbase);
  const auto* head = reinterpret_cast<const Elf64_Ehdr*>(base);
  const auto* segment = reinterpret_cast<const Elf64_Phdr*>(base + head->e_phoff);
  const std::size_t page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  for (std::size_t i = 0; i < head->e_phnum; ++i) {
    if (segment[i].p_type != PT_LOAD) continue;
    for (std::size_t at = 0; at < segment[i].p_memsz; at += page)
      static_cast<void>(*static_cast<const volatile char*>(base + segment[i].p_vaddr + at));
  }
}

}  // namespace

const char* check_object(const char* path) {
  // O_NONBLOCK: opening a named pipe must not block the Loader.
  const Fd fd(::open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!fd) return errno == ENOENT ? "there is no such file" : "the file cannot be opened";
  struct stat status{};
  if (fstat(fd.get(), &status) != 0 || !S_ISREG(status.st_mode)) return "it is not a regular file";
  if (status.st_size > kMaxObjectBytes) return "the object is larger than 64 MiB";
  Elf64_Ehdr head{};
  if (pread(fd.get(), &head, sizeof head, 0) != sizeof head || std::memcmp(head.e_ident, ELFMAG, SELFMAG) != 0)
    return "it is not an ELF object: give the file lawd made, not the source";
  constexpr unsigned char kData = std::endian::native == std::endian::little ? ELFDATA2LSB : ELFDATA2MSB;
  if (head.e_ident[EI_CLASS] != ELFCLASS64 || head.e_ident[EI_DATA] != kData || head.e_machine != kMachine)
    return "the object was made for another kind of machine";
  if (head.e_type != ET_DYN) return "it is not a shared object";
  return check_segments(fd.get(), head, static_cast<std::uint64_t>(status.st_size));
}

DlopenStore::~DlopenStore() {
  for (std::uint32_t index = 0; index < handles_.size(); ++index) unload(index);
}

wire::StageResult DlopenStore::load(std::uint32_t index, const wire::StageRequest& request, const LitheLaw*& law,
                                    std::span<char> why) {
  const auto& path = request.path;
  if (path[0] != '/' || std::memchr(path.data(), '\0', path.size()) == nullptr) {
    std::snprintf(why.data(), why.size(), "the path in the request is not an absolute, zero-terminated path");
    return wire::StageResult::hostile;
  }
  law = open(index, path.data(), why);
  return law == nullptr ? wire::StageResult::load_failed : wire::StageResult::staged;
}

const LitheLaw* DlopenStore::open(std::uint32_t index, const char* path, std::span<char> why) {
  const auto refuse = [why](const char* what, const char* colon = "", const char* about = "") {
    std::snprintf(why.data(), why.size(), "%s%s%s", what, colon, about);
    return nullptr;
  };
  if (index >= handles_.size() || handles_[index] != nullptr) return refuse("no room for another law");
  if (const char* reason = check_object(path)) return refuse(reason, ": ", path);
  void* handle = dlopen(path, RTLD_NOW | RTLD_LOCAL);
  const char* words = handle == nullptr ? dlerror() : nullptr;
  if (handle == nullptr) return refuse("cannot load", ": ", words == nullptr ? path : words);
  const auto* law = static_cast<const LitheLaw*>(dlsym(handle, "lithe_law"));
  if (law == nullptr) {
    dlclose(handle);
    return refuse("it exports no symbol lithe_law: end the law with LITHE_LAW(Type, \"name\")");
  }
  touch_pages(law);
  handles_[index] = handle;
  return law;
}

void DlopenStore::unload(std::uint32_t index) {
  if (index >= handles_.size() || handles_[index] == nullptr) return;
  dlclose(handles_[index]);
  handles_[index] = nullptr;
}

}  // namespace lithe::load
