// SPDX-License-Identifier: Apache-2.0
#include "trial/sandbox/sandbox.hpp"

#include <fcntl.h>
#include <malloc.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>

#include "spine/core/host/files.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::trial {
namespace {

Error system_error(const char* what) { return Error{std::string(what) + ": " + std::strerror(errno)}; }

// The address space in use now [bytes].
std::size_t mapped_bytes() {
  const Result<std::string> text = read_regular_file("/proc/self/statm", 1024);
  return text ? leading_number<std::size_t>(*text) * static_cast<std::size_t>(sysconf(_SC_PAGESIZE)) : 0;
}

bool limit(__rlimit_resource resource, rlim_t soft, rlim_t hard) {
  const rlimit value{soft, hard};
  return setrlimit(resource, &value) == 0;
}

}  // namespace

Outcome run_sandboxed(const std::function<int(int)>& body, const Limits& limits, std::size_t expected) {
  return run_forked(body, {.wall_ms = limits.wall_ms, .output_bytes = expected, .last_words = true});
}

bool keep_heap(std::size_t bytes) {
  if (mallopt(M_MMAP_MAX, 0) != 1 || mallopt(M_TRIM_THRESHOLD, -1) != 1) return false;
  void* volatile memory = std::malloc(bytes);  // volatile: a compiler may leave out a pair that does nothing
  std::free(memory);
  return memory != nullptr;
}

Result<> shed_rights(int pipe_fd, const Limits& limits) {
  const int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
  for (int fd = 0; fd < 3; ++fd)
    if (null < 0 || dup2(null, fd) < 0) return system_error("cannot close the standard streams");
  // Number 3 is the pipe now, and nothing else is open.
  if (pipe_fd != 3 && dup2(pipe_fd, 3) < 0) return system_error("cannot move the pipe");
  if (syscall(SYS_close_range, 4u, ~0u, 0u) != 0) return system_error("cannot close what was inherited");
  const auto cpu_s = static_cast<rlim_t>(limits.cpu_ms) / 1000 + 1;
  bool ok = limit(RLIMIT_CORE, 0, 0) && limit(RLIMIT_CPU, cpu_s, cpu_s + 1) && limit(RLIMIT_NPROC, 0, 0) &&
            limit(RLIMIT_FSIZE, 16u << 20, 16u << 20) && limit(RLIMIT_STACK, 1u << 20, 1u << 20) &&
            limit(RLIMIT_MEMLOCK, 0, 0) && limit(RLIMIT_NOFILE, 64, 64);
  const rlim_t memory = mapped_bytes() + limits.memory_bytes;
  ok = ok && (kSanitized || limit(RLIMIT_AS, memory, memory));
  if (!ok) return system_error("cannot set the limits of the trial");
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) return system_error("cannot give up new privileges");
  prctl(PR_SET_DUMPABLE, 0);
  const itimerval box{{0, 0}, {limits.cpu_ms / 1000, limits.cpu_ms % 1000 * 1000}};
  if (setitimer(ITIMER_PROF, &box, nullptr) != 0) return system_error("cannot set the time box");
  return done();
}

}  // namespace lithe::trial
