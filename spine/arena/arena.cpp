// SPDX-License-Identifier: Apache-2.0
#include "spine/arena/arena.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <string>
#include <vector>

#include "spine/arena/veneers.hpp"
#include "spine/core/host/fd.hpp"

namespace lithe::arena {
namespace {

constexpr const char* kName = "lithe-arena";
constexpr unsigned kExecutable = 0x10;  // MFD_EXEC, Linux 6.3

Error failure(const std::string& what) { return Error{what + ": " + std::strerror(errno)}; }

// A memfd of a fixed size whose pages may be executed.
Result<Fd> make_memfd(const char* name, std::uint64_t bytes, const char* what) {
  constexpr unsigned kFlags = MFD_CLOEXEC | MFD_ALLOW_SEALING;
  Fd fd(memfd_create(name, kFlags | kExecutable));
  if (!fd && errno == EINVAL) fd = Fd(memfd_create(name, kFlags));  // an older kernel needs no such flag
  if (!fd || ftruncate(fd.get(), static_cast<off_t>(bytes)) != 0 ||
      fcntl(fd.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0) {
    return failure(std::string("cannot make ") + what);
  }
  return fd;
}

// Read-only.
Fd reopen(int fd) { return Fd(open(("/proc/self/fd/" + std::to_string(fd)).c_str(), O_RDONLY | O_CLOEXEC)); }

// Read+execute at exactly this address, from a descriptor that cannot write.
Result<Mapping> map_exec(int fd, std::uint64_t address, std::size_t bytes, const char* what) {
  const Fd read_only = reopen(fd);
  if (!read_only) return failure(std::string("cannot reopen ") + what);
  void* wanted = reinterpret_cast<void*>(address);
  void* got =
      mmap(wanted, bytes, PROT_READ | PROT_EXEC, MAP_SHARED | MAP_POPULATE | MAP_FIXED_NOREPLACE, read_only.get(), 0);
  if (got == MAP_FAILED && errno == EEXIST) return Error{std::string("the address of ") + what + " is taken"};
  if (got == MAP_FAILED) return failure(std::string("cannot map ") + what + " for execution");
  Mapping mapping(got, bytes);
  if (got != wanted) return Error{std::string("the address of ") + what + " is taken"};  // kernels before 4.17
  return mapping;
}

// The stubs are written through a file as well, so that no page of this process is first writable and later executable.
Result<Mapping> map_stubs() {
  std::vector<std::byte> page(kStubBytes);
  write_stubs(page);
  const Result<Fd> fd = make_memfd("lithe-veneers", kStubBytes, "memory for stubs");
  if (!fd) return fd.error();
  if (pwrite(fd->get(), page.data(), page.size(), 0) != static_cast<ssize_t>(page.size()))
    return failure("cannot write the arena's stubs");
  return map_exec(fd->get(), kStubs, kStubBytes, "the arena's stubs");
}

}  // namespace

Result<int> make_memory() {
  Result<Fd> fd = make_memfd(kName, kBytes, "the code arena (memfd)");
  if (!fd) return fd.error();
  return fd->release();
}

bool is_memory(int fd) {
  std::array<char, 64> target{};
  const std::string link = "/proc/self/fd/" + std::to_string(fd);
  if (readlink(link.c_str(), target.data(), target.size() - 1) < 0) return false;
  struct stat status{};
  const std::string wanted = std::string("/memfd:") + kName;
  return std::strncmp(target.data(), wanted.c_str(), wanted.size()) == 0 && fstat(fd, &status) == 0 &&
         status.st_size == static_cast<off_t>(kBytes);
}

Result<int> memory_of(pid_t pid) {
  const std::string path = "/proc/" + std::to_string(pid) + "/fd/" + std::to_string(kHandedFd);
  Fd fd(open(path.c_str(), O_RDWR | O_CLOEXEC));
  if (!fd) return failure("cannot open the arena of process " + std::to_string(pid));
  if (is_memory(fd.get())) return fd.release();
  return Error{"process " + std::to_string(pid) + " has no code arena"};
}

Result<> make_read_only(int fd) {
  const Fd read_only = reopen(fd);
  if (!read_only) return failure("cannot reopen the arena");
  return dup3(read_only.get(), fd, O_CLOEXEC) == fd ? done() : failure("cannot replace the arena's descriptor");
}

Result<Arena> Arena::attach_exec(int fd) {
  if (!is_memory(fd)) return Error{"no code arena was handed over"};
  Result<Mapping> stubs = map_stubs();
  if (!stubs) return stubs.error();
  Result<Mapping> code = map_exec(fd, kBase, kBytes, "the code arena");
  if (!code) return code.error();
  return Arena(std::move(*stubs), std::move(*code));
}

Result<> Arena::lock() const {
  if (mlock(stubs_.data(), kStubBytes) != 0 || mlock(code_.data(), kBytes) != 0)
    return failure("the arena is not locked");
  return done();
}

Result<Writer> Writer::attach(int fd) {
  Result<Arena> exec = Arena::attach_exec(fd);
  if (!exec) return exec.error();
  void* view = mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
  if (view == MAP_FAILED) return failure("cannot map the code arena for writing");
  Mapping mapping(view, kBytes);
  // A law under trial in a child must not have it.
  if (madvise(view, kBytes, MADV_DONTFORK) != 0) return failure("cannot keep the arena from child processes");
  return Writer(std::move(mapping), std::move(*exec));
}

bool Writer::place(std::uint32_t slot, std::span<const std::byte> image) {
  if (!is_slot(slot) || image.size() > kSlotBytes) return false;
  std::byte* to = view_.bytes() + (slot_address(slot) - kBase);
  std::memcpy(to, image.data(), image.size());
  std::memset(to + image.size(), 0, kSlotBytes - image.size());
#if defined(__aarch64__)
  // x86-64 keeps its instruction caches coherent by itself.
  char* code = const_cast<char*>(reinterpret_cast<const char*>(exec_.slot(slot).data()));
  __builtin___clear_cache(code, code + kSlotBytes);
#endif
  return true;
}

}  // namespace lithe::arena
