// SPDX-License-Identifier: Apache-2.0
#include "spine/arena/arena.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <string>
#include <vector>

#include "spine/arena/veneers.hpp"

namespace lithe::arena {
namespace {

constexpr const char* kName = "lithe-arena";
constexpr unsigned kExecutable = 0x10;  // MFD_EXEC, Linux 6.3

Error failure(const std::string& what) { return Error{what + ": " + std::strerror(errno)}; }

// A memfd of a fixed size whose pages may be executed.
int make_memfd(const char* name, std::uint64_t bytes) {
  constexpr unsigned kFlags = MFD_CLOEXEC | MFD_ALLOW_SEALING;
  int fd = memfd_create(name, kFlags | kExecutable);
  if (fd < 0 && errno == EINVAL) fd = memfd_create(name, kFlags);  // an older kernel needs no such flag
  if (fd < 0) return -1;
  if (ftruncate(fd, static_cast<off_t>(bytes)) == 0 &&
      fcntl(fd, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) == 0) {
    return fd;
  }
  const int reason = errno;
  close(fd);
  errno = reason;
  return -1;
}

int reopen(int fd, int flags) { return open(("/proc/self/fd/" + std::to_string(fd)).c_str(), flags | O_CLOEXEC); }

// Read+execute at exactly this address, from a descriptor that cannot write.
Result<Mapping> map_exec(int fd, std::uint64_t address, std::size_t bytes, const char* what) {
  const int read_only = reopen(fd, O_RDONLY);
  if (read_only < 0) return failure(std::string("cannot reopen ") + what);
  void* wanted = reinterpret_cast<void*>(address);
  void* got = mmap(wanted, bytes, PROT_READ | PROT_EXEC, MAP_SHARED | MAP_POPULATE | MAP_FIXED_NOREPLACE, read_only, 0);
  const int reason = errno;
  close(read_only);
  if (got == MAP_FAILED && reason == EEXIST) return Error{std::string("the address of ") + what + " is taken"};
  if (got == MAP_FAILED) return Error{std::string("cannot map ") + what + " for execution: " + std::strerror(reason)};
  Mapping mapping(got, bytes);
  if (got != wanted) return Error{std::string("the address of ") + what + " is taken"};  // kernels before 4.17
  return mapping;
}

// The stubs are written through a file as well, so that no page of this process is first writable and later executable.
Result<Mapping> map_stubs() {
  std::vector<std::byte> page(kStubBytes);
  write_stubs(page);
  const int fd = make_memfd("lithe-veneers", kStubBytes);
  if (fd < 0) return failure("cannot make memory for stubs");
  const bool written = pwrite(fd, page.data(), page.size(), 0) == static_cast<ssize_t>(page.size());
  Result<Mapping> stubs = written ? map_exec(fd, kStubs, kStubBytes, "the arena's stubs")
                                  : Result<Mapping>(failure("cannot write the arena's stubs"));
  close(fd);
  return stubs;
}

}  // namespace

Result<int> make_memory() {
  const int fd = make_memfd(kName, kBytes);
  if (fd < 0) return failure("cannot make the code arena (memfd)");
  return fd;
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
  const int fd = open(path.c_str(), O_RDWR | O_CLOEXEC);
  if (fd < 0) return failure("cannot open the arena of process " + std::to_string(pid));
  if (is_memory(fd)) return fd;
  close(fd);
  return Error{"process " + std::to_string(pid) + " has no code arena"};
}

Result<> make_read_only(int fd) {
  const int read_only = reopen(fd, O_RDONLY);
  if (read_only < 0) return failure("cannot reopen the arena");
  const bool replaced = dup3(read_only, fd, O_CLOEXEC) == fd;
  close(read_only);
  if (!replaced) return failure("cannot replace the arena's descriptor");
  return done();
}

Mapping::~Mapping() {
  if (at_ != nullptr) munmap(at_, bytes_);
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
  if (mlock(stubs_.get(), kStubBytes) != 0 || mlock(code_.get(), kBytes) != 0)
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
  std::byte* to = static_cast<std::byte*>(view_.get()) + (slot_address(slot) - kBase);
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
