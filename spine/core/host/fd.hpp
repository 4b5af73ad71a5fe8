// SPDX-License-Identifier: Apache-2.0
// A file descriptor that is closed with its object. Off the tick.
#pragma once

#include <unistd.h>

#include <utility>

#include "spine/core/rt.hpp"

namespace lithe {

class Fd {
 public:
  Fd() = default;
  explicit Fd(int fd) : fd_(fd) {}
  Fd(Fd&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Fd& operator=(Fd&& other) noexcept {
    reset(other.release());
    return *this;
  }
  ~Fd() { reset(); }

  explicit operator bool() const { return fd_ >= 0; }
  int get() const LITHE_RT { return fd_; }
  int release() { return std::exchange(fd_, -1); }
  // Closes it, and owns another one from now on.
  void reset(int fd = -1) {
    if (fd_ >= 0) ::close(fd_);
    fd_ = fd;
  }

 private:
  int fd_ = -1;
};

}  // namespace lithe
