// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/descriptor.hpp"

#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#if defined(__has_feature)
#if __has_feature(realtime_sanitizer)
#include <sanitizer/rtsan_interface.h>
#define LITHE_SYSTEM_CALL __rtsan::ScopedDisabler known_to_be_one
#endif
#endif
#ifndef LITHE_SYSTEM_CALL
#define LITHE_SYSTEM_CALL
#endif

namespace lithe::hal {
namespace {

Moved outcome(ssize_t bytes, int error) LITHE_RT {
  if (bytes >= 0) return {static_cast<std::size_t>(bytes), 0};
  if (error == EAGAIN || error == EWOULDBLOCK || error == EINTR) return {};
  return {0, error};
}

// `at_none`: the error that no bytes mean.
template <class Call>
Moved without_waiting(Call call, int at_none) LITHE_RT {
  Moved moved;
  LITHE_RT_EXEMPT("a read or write that never waits: it copies what the kernel has, or has room for", {
    LITHE_SYSTEM_CALL;
    const ssize_t bytes = call();
    moved = outcome(bytes, errno);
    if (bytes == 0) moved.error = at_none;
  });
  return moved;
}

}  // namespace

Descriptor::Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}

Descriptor& Descriptor::operator=(Descriptor&& other) noexcept {
  if (this != &other) {
    close();
    fd_ = std::exchange(other.fd_, -1);
  }
  return *this;
}

Descriptor::~Descriptor() { close(); }

void Descriptor::close() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

Moved Descriptor::read(std::span<std::byte> to) const LITHE_RT {
  // The end of a terminal or a socket: nobody is there any more.
  return without_waiting([&] { return ::read(fd_, to.data(), to.size()); }, to.empty() ? 0 : EIO);
}

Moved Descriptor::write(std::span<const std::byte> from) const LITHE_RT {
  return without_waiting([&] { return ::write(fd_, from.data(), from.size()); }, 0);
}

void nap() LITHE_RT {
  constexpr timespec kNap{0, 20'000};
  LITHE_RT_EXEMPT("the Transport's own thread, which has nothing to do until a device answers", {
    LITHE_SYSTEM_CALL;
    nanosleep(&kNap, nullptr);
  });
}

}  // namespace lithe::hal
