// SPDX-License-Identifier: Apache-2.0
// Memory from mmap, owned. Off the tick.
#pragma once

#include <sys/mman.h>
#include <unistd.h>

#include <cstddef>
#include <utility>

#include "spine/core/rt.hpp"

namespace lithe {

// A number of bytes, rounded up to whole pages.
inline std::size_t whole_pages(std::size_t bytes) {
  const auto page = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  return (bytes + page - 1) / page * page;
}

// Unmapped with this object.
class Mapping {
 public:
  Mapping() = default;
  Mapping(void* data, std::size_t size) : data_(data), size_(size) {}
  Mapping(Mapping&& other) noexcept : data_(std::exchange(other.data_, nullptr)), size_(other.size_) {}
  Mapping& operator=(Mapping&& other) noexcept {
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    return *this;
  }
  ~Mapping() {
    if (data_ != nullptr) munmap(data_, size_);
  }

  // New pages of this process, zeroed; empty when they are refused (errno).
  static Mapping make(std::size_t size, int protection, int flags = 0) {
    void* data = mmap(nullptr, size, protection, MAP_PRIVATE | MAP_ANONYMOUS | flags, -1, 0);
    return data == MAP_FAILED ? Mapping() : Mapping(data, size);
  }

  explicit operator bool() const { return data_ != nullptr; }
  void* data() const LITHE_RT { return data_; }
  std::byte* bytes() const LITHE_RT { return static_cast<std::byte*>(data_); }
  std::size_t size() const LITHE_RT { return size_; }

 private:
  void* data_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace lithe
