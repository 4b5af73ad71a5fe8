// SPDX-License-Identifier: Apache-2.0
#include "trial/sections/guarded.hpp"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "spine/core/host/fd.hpp"

namespace lithe::trial {
namespace {

constexpr std::byte kPattern{0xA5};

// Maps `inside` bytes with an inaccessible page on either side.
std::byte* reserve(std::size_t inside, std::size_t page) {
  void* at = mmap(nullptr, inside + 2 * page, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (at == MAP_FAILED) std::abort();
  return static_cast<std::byte*>(at) + page;
}

void map_over(std::byte* at, std::size_t inside, int sharing) {
  const int flags = MAP_FIXED | MAP_POPULATE | MAP_ANONYMOUS | sharing;
  if (mmap(at, inside, PROT_READ | PROT_WRITE, flags, -1, 0) == MAP_FAILED) std::abort();
}

// Both views of a file in memory: where mremap gives no second view (qemu-user).
void view_of_file(std::byte* at, std::byte* pages, std::size_t inside) {
  const Fd file(memfd_create("lithe-law", MFD_CLOEXEC));
  if (!file || ftruncate(file.get(), static_cast<off_t>(inside)) != 0) std::abort();
  for (std::byte* view : {at, pages}) {
    constexpr int kFlags = MAP_SHARED | MAP_FIXED;
    if (mmap(view, inside, PROT_READ | PROT_WRITE, kFlags, file.get(), 0) == MAP_FAILED) std::abort();
  }
}

// The same pages once more, read-only. Of a shared mapping, an old size of 0 asks for a second view.
void view_over(std::byte* at, std::byte* pages, std::size_t inside, std::size_t page) {
  if (mremap(pages, 0, inside, MREMAP_MAYMOVE | MREMAP_FIXED, at) == MAP_FAILED) view_of_file(at, pages, inside);
  if (mprotect(at, inside, PROT_READ) != 0) std::abort();
  for (std::size_t i = 0; i < inside; i += page) (void)*const_cast<volatile std::byte*>(at + i);  // no fault in a step
}

}  // namespace

Guarded::Guarded(std::size_t bytes, Kind kind) : size_(bytes) {
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  const std::size_t inside = std::max<std::size_t>(1, (bytes + page - 1) / page) * page;
  const bool two = kind == Kind::with_read_only_view;
  std::byte* ours = reserve(inside, page);
  map_over(ours, inside, two ? MAP_SHARED : MAP_PRIVATE);
  std::byte* theirs = ours;
  if (two) {
    theirs = reserve(inside, page);
    view_over(theirs, ours, inside, page);
  }
  data_ = ours + inside - bytes;
  law_view_ = theirs + inside - bytes;
  fence_ = {ours, inside - bytes};
  std::fill(fence_.begin(), fence_.end(), kPattern);
}

bool Guarded::fence_intact() const {
  if (fence_.empty()) return true;
  // Compares each byte with the one before it: as fast as memcmp, because it runs after every step.
  return fence_[0] == kPattern && std::memcmp(fence_.data(), fence_.data() + 1, fence_.size() - 1) == 0;
}

}  // namespace lithe::trial
