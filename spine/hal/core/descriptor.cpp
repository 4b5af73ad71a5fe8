// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/core/descriptor.hpp"

#include <linux/sock_diag.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <cerrno>

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

struct Answer {
  ssize_t value;
  int error;  // errno
};

// Only for calls that never wait, such as those on a descriptor that is non-blocking; and for nap().
template <class Call>
Answer ask_kernel(Call call) LITHE_RT {
  Answer answer{};
  LITHE_RT_EXEMPT("a call that never waits: the kernel copies what it has, or has room for; but a nap of 20 us", {
    LITHE_SYSTEM_CALL;
    answer.value = call();
    answer.error = errno;
  });
  return answer;
}

Moved outcome(const Answer& answer) LITHE_RT {
  if (answer.value >= 0) return {static_cast<std::size_t>(answer.value), 0};
  if (answer.error == EAGAIN || answer.error == EWOULDBLOCK || answer.error == EINTR) return {};
  return {0, answer.error};
}

// 0 when it is not a socket.
std::uint32_t socket_memory(int fd, std::size_t which) LITHE_RT {
  std::array<std::uint32_t, SK_MEMINFO_VARS> memory{};
  socklen_t size = sizeof memory;
  const Answer answer =
      ask_kernel([&] { return ssize_t{getsockopt(fd, SOL_SOCKET, SO_MEMINFO, memory.data(), &size)}; });
  return answer.value == 0 ? memory[which] : 0;
}

}  // namespace

Moved Descriptor::read(std::span<std::byte> to) const LITHE_RT {
  const Answer answer = ask_kernel([&] { return ::read(get(), to.data(), to.size()); });
  Moved moved = outcome(answer);
  if (answer.value == 0 && !to.empty()) moved.error = EIO;  // end of file: the other end is closed
  return moved;
}

Moved Descriptor::write(std::span<const std::byte> from) const LITHE_RT {
  return outcome(ask_kernel([&] { return ::write(get(), from.data(), from.size()); }));
}

std::uint32_t Descriptor::unsent_bytes() const LITHE_RT { return socket_memory(get(), SK_MEMINFO_WMEM_ALLOC); }

std::uint32_t Descriptor::dropped() const LITHE_RT { return socket_memory(get(), SK_MEMINFO_DROPS); }

void nap() LITHE_RT {
  constexpr timespec kNap{0, 20'000};
  ask_kernel([&] { return ssize_t{nanosleep(&kNap, nullptr)}; });
}

}  // namespace lithe::hal
