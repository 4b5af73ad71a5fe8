// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/memory/protected_memory.hpp"

#include <cerrno>
#include <cstring>
#include <string>

namespace lithe::contain {
namespace {

int new_key() {
#if defined(__x86_64__)
  return pkey_alloc(0, 0);
#else
  errno = ENOSYS;  // AArch64 has a similar feature since 2024; no supported board has it
  return -1;
#endif
}

}  // namespace

Result<std::unique_ptr<ProtectedMemory>> ProtectedMemory::make(std::size_t bytes, Protection wanted) {
  const int key = wanted == Protection::copies ? -1 : new_key();
  if (key < 0 && wanted == Protection::keys) {
    return Error{std::string("memory protection keys were refused (") + std::strerror(errno) +
                 "): this machine has none, or all are in use; take Protection::best"};
  }
  std::unique_ptr<ProtectedMemory> memory(new ProtectedMemory(key));
  Mapping& pages = memory->pages_ = Mapping::make(whole_pages(bytes), PROT_READ | PROT_WRITE, MAP_POPULATE);
  if (!pages) {
    return Error{"no " + std::to_string(whole_pages(bytes)) +
                 " bytes for the protected memory: " + std::strerror(errno)};
  }
  mlock(pages.data(), pages.size());  // without the right to lock it is at least resident now
#if defined(__x86_64__)
  if (key >= 0 && pkey_mprotect(pages.data(), pages.size(), PROT_READ | PROT_WRITE, key) != 0)
    return Error{std::string("the protected memory's pages take no protection key: ") + std::strerror(errno)};
#endif
  return memory;
}

ProtectedMemory::~ProtectedMemory() {
  pages_ = Mapping();  // before its key
#if defined(__x86_64__)
  if (key_ >= 0) pkey_free(key_);
#endif
}

void* ProtectedMemory::allocate(std::size_t bytes, std::size_t alignment) {
  const std::size_t from = (used_ + alignment - 1) / alignment * alignment;
  if (from > pages_.size() || bytes > pages_.size() - from) return nullptr;
  used_ = from + bytes;
  return pages_.bytes() + from;
}

Result<> ProtectedMemory::guard(void* block, std::size_t bytes) {
  auto* from = static_cast<std::byte*>(block);
  if (key_ >= 0) {
    if (from >= pages_.bytes() && from + bytes <= pages_.bytes() + pages_.size()) return done();
    return Error{"a guarded block lies outside the protected memory, where its key does not reach: allocate it there"};
  }
  if (blocks_used_ == blocks_.size()) {
    return Error{"the protected memory guards " + std::to_string(blocks_.size()) +
                 " blocks already: join some of them"};
  }
  Block guarded{from, static_cast<std::byte*>(allocate(bytes)), static_cast<std::byte*>(allocate(bytes)), bytes};
  if (guarded.copy == nullptr || guarded.second == nullptr)
    return Error{"the protected memory is too small for two copies of a block of " + std::to_string(bytes) + " bytes"};
  blocks_[blocks_used_++] = guarded;
  return done();
}

void ProtectedMemory::open_for_this_thread() const {
#if defined(__x86_64__)
  if (key_ >= 0) pkey_set(key_, 0);
#endif
}

void ProtectedMemory::remember(const Block& block) LITHE_RT {
  std::memcpy(block.copy, block.original, block.bytes);
  std::memcpy(block.second, block.original, block.bytes);
}

const void* ProtectedMemory::check(const Block& block) LITHE_RT {
  if (std::memcmp(block.original, block.copy, block.bytes) == 0 &&
      std::memcmp(block.copy, block.second, block.bytes) == 0) {
    return nullptr;
  }
  // Majority of three: only a law that hits two of them at the same offset is not detected.
  const std::byte* good = std::memcmp(block.copy, block.second, block.bytes) == 0 ? block.copy : block.original;
  const void* where = nullptr;
  for (std::size_t i = 0; i < block.bytes && where == nullptr; ++i) {
    if (block.original[i] != good[i]) where = block.original + i;
    if (block.copy[i] != good[i]) where = block.copy + i;
    if (block.second[i] != good[i]) where = block.second + i;
  }
  if (good != block.original) std::memcpy(block.original, good, block.bytes);
  return where;
}

}  // namespace lithe::contain
