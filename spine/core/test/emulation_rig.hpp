// SPDX-License-Identifier: Apache-2.0
// For tests: whether an emulator of user programs (qemu-user) runs this process. It passes system calls on to a kernel
// for another kind of machine, and answers some of them itself. A test skips itself only for what is named here.
#pragma once

#include <elf.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <ctime>
#include <string>

#include "spine/core/host/fd.hpp"
#include "spine/core/mapping.hpp"

namespace lithe::test {

// The kind of machine a program file is for (EM_X86_64, EM_AARCH64); EM_NONE when it cannot be read.
inline std::uint16_t machine_of(const std::string& path) {
  Elf64_Ehdr head{};
  const Fd file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  return file && ::read(file.get(), &head, sizeof head) == sizeof head ? head.e_machine : std::uint16_t{EM_NONE};
}

// True when the kernel executes a program for another kind of machine than this one. qemu-user pretends that
// /proc/self/exe is the emulated program, and passes on the same link below task/.
inline bool is_emulated() {
  const std::uint16_t ours = machine_of("/proc/self/exe");
  const std::uint16_t executed = machine_of("/proc/self/task/" + std::to_string(::gettid()) + "/exe");
  return ours != EM_NONE && executed != EM_NONE && executed != ours;
}

// Why no law can be tried here; "" when it can. A trial runs behind a filter of system calls (seccomp), and qemu-user,
// as some kernels, has none.
inline std::string why_no_trial() {
  return ::prctl(PR_GET_SECCOMP) >= 0 ? ""
                                      : "this system has no filters of system calls, without which no law is tried";
}

// Why a limit of memory holds nobody here; "" when it does. qemu-user takes RLIMIT_AS and sets nothing.
inline std::string why_memory_is_unlimited() {
  rlimit before{}, after{};
  ::getrlimit(RLIMIT_AS, &before);
  const rlimit wanted{std::min(rlim_t{1} << 46, before.rlim_max) - 65536, before.rlim_max};
  ::setrlimit(RLIMIT_AS, &wanted);
  ::getrlimit(RLIMIT_AS, &after);
  ::setrlimit(RLIMIT_AS, &before);
  return after.rlim_cur == wanted.rlim_cur ? "" : "RLIMIT_AS has no effect here";
}

// Why the second piece of code at an address, written through another mapping, is not what runs there; "" when it is.
// AArch64 has an instruction for that (IC IVAU); qemu-user before 8.1 does nothing for it. A real core that runs the
// old code is no reason to skip a test.
inline std::string why_code_stays_old() {
#if defined(__aarch64__)
  constexpr std::size_t kBytes = 65536;
  const Fd file(static_cast<int>(::syscall(SYS_memfd_create, "lithe-test", 0u)));
  if (::ftruncate(file.get(), kBytes) != 0) return "";
  const Mapping written(::mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_SHARED, file.get(), 0), kBytes);
  const Mapping run(::mmap(nullptr, kBytes, PROT_READ | PROT_EXEC, MAP_SHARED, file.get(), 0), kBytes);
  if (written.data() == MAP_FAILED || run.data() == MAP_FAILED) return "";
  const auto answer = [&](std::uint32_t value) {
    auto* words = static_cast<volatile std::uint32_t*>(written.data());
    words[0] = 0x52800000u | value << 5;  // mov w0, #value
    words[1] = 0xd65f03c0u;               // ret
    auto* code = static_cast<char*>(run.data());
    __builtin___clear_cache(code, code + 8);
    return reinterpret_cast<std::uint32_t (*)()>(run.data())();
  };
  if (answer(1) == 1 && answer(2) == 1 && is_emulated())
    return "this qemu-user keeps running old code where new code was placed (before 8.1)";
#endif
  return "";
}

// Why a child still has memory that its parent keeps from it (MADV_DONTFORK); "" when it has not. Tried: a child
// touches such a page, and ends by it or not. qemu-user forgets it; a kernel that does is no reason to skip a test.
inline std::string why_children_keep_memory() {
  constexpr std::size_t kBytes = 65536;
  const Mapping page(::mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0), kBytes);
  if (page.data() == MAP_FAILED || ::madvise(page.data(), kBytes, MADV_DONTFORK) != 0) return "";
  const pid_t child = ::fork();
  if (child == 0) {
    ::signal(SIGSEGV, SIG_DFL);
    ::_exit(*static_cast<volatile char*>(page.data()) == 0 ? 0 : 1);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) && is_emulated() ? "MADV_DONTFORK has no effect in this qemu-user" : "";
}

// Why a thread needs more than `limit_ns` of its CPU time to take a signal and to come back from its handler; "" when
// it does not. Tried: it sends itself twenty, and the fastest counts. A real kernel that is so slow is no reason to
// skip a test.
inline std::string why_signals_are_slow(std::int64_t limit_ns) {
  if (!is_emulated()) return "";
  const auto now_ns = [] {
    timespec now{};
    ::clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
  };
  struct sigaction ours{}, before{};
  ours.sa_handler = [](int) {};
  ::sigaction(SIGUSR2, &ours, &before);
  std::int64_t best_ns = INT64_MAX;
  for (int i = 0; i < 20; ++i) {
    const std::int64_t sent_ns = now_ns();
    ::syscall(SYS_tgkill, ::getpid(), ::gettid(), SIGUSR2);  // taken before the call returns
    best_ns = std::min(best_ns, now_ns() - sent_ns);
  }
  ::sigaction(SIGUSR2, &before, nullptr);
  if (best_ns <= limit_ns) return "";
  return "this qemu-user needs " + std::to_string(best_ns / 1000) + " us for a signal, and a notice lasts " +
         std::to_string(limit_ns / 1000) + " us";
}

}  // namespace lithe::test
