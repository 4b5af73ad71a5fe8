// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/fault_barrier.hpp"

#include <pthread.h>
#include <sys/auxv.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <utility>

#include "spine/contain/core.hpp"
#include "spine/contain/memory/constants.hpp"
#include "spine/contain/watchdog.hpp"

namespace lithe::contain {
namespace {

// A handler's frames are small; the kernel's own frame holds every vector register of the processor.
std::size_t handler_stack_bytes() {
#ifdef AT_MINSIGSTKSZ
  const std::size_t frame = getauxval(AT_MINSIGSTKSZ);
#else
  const std::size_t frame = 0;
#endif
  return whole_pages((std::size_t{64} << 10) + frame);
}

void touch(void* from, std::size_t bytes, std::size_t page) {
  for (std::size_t at = 0; at < bytes; at += page) static_cast<volatile char*>(from)[at] = 0;
}

}  // namespace

Result<FaultBarrier> FaultBarrier::open(ProtectedMemory* protected_memory) {
  if (entrance().core != nullptr)
    return Error{"this thread has a FaultBarrier already: one is enough for all its laws"};
  Result<LawStack> law_stack = LawStack::make();
  if (!law_stack) return law_stack.error();
  const std::size_t page = whole_pages(1), stack_bytes = handler_stack_bytes(), core_bytes = whole_pages(sizeof(Core));
  Mapping mapping = Mapping::make(page + stack_bytes + core_bytes, PROT_READ | PROT_WRITE);
  if (!mapping) return Error{std::string("no memory for a handler's stack: ") + std::strerror(errno)};
  std::byte* stack = mapping.bytes() + page;
  void* place =
      protected_memory == nullptr ? stack + stack_bytes : protected_memory->allocate(sizeof(Core), alignof(Core));
  stack_t alternate{};
  alternate.ss_sp = stack;
  alternate.ss_size = stack_bytes;
  stack_t before{};
  if (place == nullptr || mprotect(mapping.data(), page, PROT_NONE) != 0 || sigaltstack(&alternate, &before) != 0) {
    const std::string why = place == nullptr ? "the protected memory is full" : std::strerror(errno);
    return Error{"no alternate stack for this thread's signal handlers: " + why};
  }
  mlock(stack, stack_bytes + core_bytes);  // without permission to lock, it is at least resident now
  touch(stack, stack_bytes + core_bytes, page);

  Core* core = ::new (place) Core;
  core->law_stack = std::move(*law_stack);
  core->protected_memory = protected_memory;
  if (protected_memory != nullptr && protected_memory->key() >= 0) core->key = MemoryKey::of(protected_memory->key());
  core->environment = Environment::now();
  core->thread = static_cast<pid_t>(syscall(SYS_gettid));
  pthread_getcpuclockid(pthread_self(), &core->cpu_clock);
  core->mapping = std::move(mapping);
  core->stack_before = before;
  pthread_sigmask(SIG_SETMASK, nullptr, &core->mask);
  entrance() = {core, core->key};
  return FaultBarrier(core);
}

void FaultBarrier::Close::operator()(Core* core) const {
  if (core->watchdog != nullptr) core->watchdog->forget(*core);
  if (core->gated) stop_dispatch();
  if (core->constants != nullptr) core->constants->forget(&entrance());
  entrance() = {};
  stack_t before = core->stack_before;
  before.ss_flags &= ~SS_ONSTACK;
  sigaltstack(&before, nullptr);
  core->law_stack.forget_frames();
  const Mapping mapping = std::move(core->mapping);  // which may hold the core itself
  std::destroy_at(core);
}

Result<> FaultBarrier::watch_entrance(Constants& constants) {
  core_->constants = &constants;
  return constants.watch("how a thread comes back from a law", &entrance(), sizeof(Entrance));
}

Result<> FaultBarrier::guard(void* block, std::size_t bytes) {
  if (core_->protected_memory == nullptr) return done();
  core_->guards = true;
  return core_->protected_memory->guard(block, bytes);
}

// A separate function, so that no value in a register has to survive the jump.
[[gnu::noinline]] Failure FaultBarrier::run(std::int64_t deadline_ns, Call call, void* context) LITHE_RT {
  Core& core = *core_;
  core.failure = {};
  if (core.guards) core.protected_memory->remember();
  core.deadline_ns.store(deadline_ns, std::memory_order_relaxed);
  LITHE_RT_EXEMPT("sigsetjmp(env, 0) saves registers only; how long a law takes is the Watchdog's business", {
    if (sigsetjmp(core.back, 0) == 0) {
      core.system_calls = core.gated ? 1 : 0;
      // release: partner of the acquire in Watchdog::look(), which must see this call's deadline.
      core.call.store(++core.serial, std::memory_order_release);
      core.law_stack.run(call, context);
      core.environment.restore();
      core.key.allow_writes();
      std::atomic_signal_fence(std::memory_order_seq_cst);  // keeps the law's memory accesses inside the call
      core.call.store(0, std::memory_order_relaxed);
      core.system_calls = 0;
    } else {
      core.environment.restore();  // break_off() has done the rest
      core.law_stack.forget_frames();
    }
  });
  if (!core.guards) return core.failure;
  const void* broken = core.protected_memory->check();
  if (broken != nullptr && !core.failure)
    core.failure = {wire::LawFaultKind::state_broken, 0, reinterpret_cast<std::uintptr_t>(broken)};
  return core.failure;
}

std::uint64_t FaultBarrier::late_signals() const LITHE_RT {
  return core_->late_signals.load(std::memory_order_relaxed);
}

}  // namespace lithe::contain
