// SPDX-License-Identifier: Apache-2.0
// A non-blocking file descriptor.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/core/host/fd.hpp"
#include "spine/core/rt.hpp"

namespace lithe::hal {

// Result of one read or write. No error and no bytes: it would have blocked.
struct Moved {
  std::size_t bytes = 0;
  int error = 0;  // errno; EIO also when the other end is gone
};

// Contract: owns its file descriptor, which is non-blocking · read, write RT: one system call each that copies what the
// kernel holds or has room for, and returns · the rest never in the tick
class Descriptor {
 public:
  explicit Descriptor(int fd = -1) : fd_(fd) {}

  int get() const LITHE_RT { return fd_.get(); }
  bool is_open() const LITHE_RT { return fd_.get() >= 0; }
  void close() { fd_.reset(); }

  Moved read(std::span<std::byte> to) const LITHE_RT;
  Moved write(std::span<const std::byte> from) const LITHE_RT;

  // Socket only: memory of data written but not sent yet [bytes]. 0: all sent, or unknown.
  std::uint32_t unsent_bytes() const LITHE_RT;
  // Socket only: frames dropped because its receive queue was full, since it was opened. 0: none, or unknown.
  std::uint32_t dropped() const LITHE_RT;

 private:
  Fd fd_;
};

// Sleeps for a moment.
// Contract: a thread that waits for a bus and shares its core; never the tick
void nap() LITHE_RT;

}  // namespace lithe::hal
