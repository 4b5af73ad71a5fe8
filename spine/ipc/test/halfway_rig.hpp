// SPDX-License-Identifier: Apache-2.0
// For tests: interrupts a copy in its middle, always at the same word.
#pragma once

#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstddef>
#include <cstdlib>
#include <functional>
#include <new>
#include <utility>

#if defined(__has_feature)
#if __has_feature(realtime_sanitizer)
#include <sanitizer/rtsan_interface.h>
#define LITHE_TEST_INTERRUPTION __rtsan::ScopedDisabler not_in_the_tick
#endif
#endif
#ifndef LITHE_TEST_INTERRUPTION
#define LITHE_TEST_INTERRUPTION
#endif

namespace lithe::ipc::test {

// A T whose second half lies on pages that cannot be touched. Whoever copies from or to it faults in the middle of the
// copy; `meanwhile` runs then, the pages come back, and the copy goes on. So a test can change the memory, or kill the
// writer, between two given words, without a hook in the code under test.
// Contract: one armed at a time · the test's thread only
template <class T>
class Halfway {
 public:
  Halfway() {
    pages_ = static_cast<unsigned char*>(
        mmap(nullptr, 2 * kHalf, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
    if (pages_ == MAP_FAILED) std::abort();
    value_ = new (pages_ + kHalf - sizeof(T) / 16 * 8) T{};
  }
  explicit Halfway(const T& value) : Halfway() { *value_ = value; }
  ~Halfway() { munmap(pages_, 2 * kHalf); }
  Halfway(const Halfway&) = delete;
  Halfway& operator=(const Halfway&) = delete;

  T& operator*() { return *value_; }

  // The next touch of the second half runs `meanwhile`.
  void arm(std::function<void()> meanwhile) {
    meanwhile_ = std::move(meanwhile);
    struct sigaction action{};
    action.sa_handler = on_fault;
    action.sa_flags = SA_NODEFER;
    sigaction(SIGSEGV, &action, &before_);
    armed_ = this;
    fired_ = false;
    mprotect(pages_ + kHalf, kHalf, PROT_NONE);
  }
  // True once the copy has been stopped.
  bool fired() const { return fired_; }

 private:
  static constexpr std::size_t kPage = 65536;  // a multiple of every page size Linux has
  static constexpr std::size_t kHalf = (sizeof(T) / kPage + 1) * kPage;

  static void on_fault(int) {
    LITHE_TEST_INTERRUPTION;
    Halfway* self = std::exchange(armed_, nullptr);
    if (self == nullptr) std::abort();  // a fault of another kind: no endless loop
    sigaction(SIGSEGV, &self->before_, nullptr);
    mprotect(self->pages_ + kHalf, kHalf, PROT_READ | PROT_WRITE);
    self->fired_ = true;
    self->meanwhile_();
  }

  inline static Halfway* armed_ = nullptr;
  unsigned char* pages_;
  T* value_;
  std::function<void()> meanwhile_;
  struct sigaction before_{};
  volatile bool fired_ = false;
};

// A zeroed T that child processes share.
template <class T>
class Shared {
 public:
  Shared()
      : memory_(static_cast<T*>(mmap(nullptr, sizeof(T), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0))) {
    if (memory_ == MAP_FAILED) std::abort();
  }
  ~Shared() { munmap(memory_, sizeof(T)); }
  Shared(const Shared&) = delete;
  Shared& operator=(const Shared&) = delete;
  T& operator*() { return *memory_; }
  T* operator->() { return memory_; }

 private:
  T* memory_;
};

// Runs `body` in a child process that does not outlive the test.
template <class Body>
pid_t start_child(Body body) {
  const pid_t child = fork();
  if (child != 0) return child;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  body();
  _exit(0);
}

// Runs `body` in a child process and waits for its end; body usually ends with kill_self().
template <class Body>
void in_child(Body body) {
  const pid_t child = start_child(body);
  waitpid(child, nullptr, 0);
}

inline void kill_self() { kill(getpid(), SIGKILL); }

}  // namespace lithe::ipc::test
