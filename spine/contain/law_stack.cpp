// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/law_stack.hpp"

#include <cerrno>
#include <cstring>
#include <string>

#include "spine/contain/core.hpp"

#if defined(__SANITIZE_ADDRESS__)
#define LITHE_ASAN 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define LITHE_ASAN 1
#endif
#endif
#ifdef LITHE_ASAN
#include <sanitizer/asan_interface.h>
#endif

extern "C" [[gnu::visibility("hidden")]] void lithe_contain_run_on(std::byte* top,
                                                                   lithe::contain::FaultBarrier::Call call,
                                                                   void* context, void** way_back) LITHE_RT;

// Saves the callee-saved registers on the thread's stack, and the stack pointer in `way_back`; then runs the law on the
// law stack. Calls and returns are balanced, so the processor predicts the returns.
#if defined(__x86_64__)
asm(R"(
  .text
  .p2align 4
  .hidden lithe_contain_run_on
  .globl lithe_contain_run_on
  .type lithe_contain_run_on, @function
lithe_contain_run_on:
  pushq %rbp
  pushq %rbx
  pushq %r12
  pushq %r13
  pushq %r14
  pushq %r15
  movq %rsp, (%rcx)
  movq %rdi, %rsp
  movq %rsi, %rbx
  movq %rdx, %r12
  xorl %ebp, %ebp
  call lithe_contain_shut
  movq %r12, %rdi
  call *%rbx
  cld
  call lithe_contain_way_back
  movq %rax, %rsp
  popq %r15
  popq %r14
  popq %r13
  popq %r12
  popq %rbx
  popq %rbp
  ret
  .size lithe_contain_run_on, .-lithe_contain_run_on
)");
#else
asm(R"(
  .text
  .p2align 4
  .hidden lithe_contain_run_on
  .globl lithe_contain_run_on
  .type lithe_contain_run_on, %function
lithe_contain_run_on:
  stp x29, x30, [sp, #-160]!
  stp x19, x20, [sp, #16]
  stp x21, x22, [sp, #32]
  stp x23, x24, [sp, #48]
  stp x25, x26, [sp, #64]
  stp x27, x28, [sp, #80]
  stp d8, d9, [sp, #96]
  stp d10, d11, [sp, #112]
  stp d12, d13, [sp, #128]
  stp d14, d15, [sp, #144]
  mov x9, sp
  str x9, [x3]
  mov sp, x0
  mov x19, x1
  mov x20, x2
  mov x29, xzr
  bl lithe_contain_shut
  mov x0, x20
  blr x19
  bl lithe_contain_way_back
  mov sp, x0
  ldp x19, x20, [sp, #16]
  ldp x21, x22, [sp, #32]
  ldp x23, x24, [sp, #48]
  ldp x25, x26, [sp, #64]
  ldp x27, x28, [sp, #80]
  ldp d8, d9, [sp, #96]
  ldp d10, d11, [sp, #112]
  ldp d12, d13, [sp, #128]
  ldp d14, d15, [sp, #144]
  ldp x29, x30, [sp], #160
  ret
  .size lithe_contain_run_on, .-lithe_contain_run_on
)");
#endif

namespace lithe::contain {

Result<LawStack> LawStack::make() {
  LawStack stack;
  stack.memory_ = Mapping::make(kLawStackBytes + 2 * kLawGuardBytes, PROT_NONE, MAP_NORESERVE);
  if (!stack.memory_ || mprotect(stack.memory_.bytes() + kLawGuardBytes, kLawStackBytes, PROT_READ | PROT_WRITE) != 0)
    return Error{std::string("no memory for a law's stack: ") + std::strerror(errno)};
  std::byte* bottom = stack.memory_.bytes() + kLawGuardBytes;
  mlock(bottom, kLawStackBytes);  // without the right to lock it is at least resident now
  std::memset(bottom, 0, kLawStackBytes);
  return stack;
}

void LawStack::forget_frames() const LITHE_RT {
#ifdef LITHE_ASAN
  LITHE_RT_EXEMPT("AddressSanitizer's own, in its builds only",
                  { __asan_unpoison_memory_region(memory_.bytes() + kLawGuardBytes, kLawStackBytes); });
#endif
}

LITHE_LEFT_BY_A_JUMP void LawStack::run(FaultBarrier::Call call, void* context) LITHE_RT {
  lithe_contain_run_on(memory_.bytes() + kLawGuardBytes + kLawStackBytes, call, context, &way_back_);
}

}  // namespace lithe::contain

void lithe_contain_shut() noexcept { lithe::contain::entrance().core->key.forbid_writes(); }

void* lithe_contain_way_back() noexcept { return lithe::contain::entrance().core->law_stack.way_back_; }
