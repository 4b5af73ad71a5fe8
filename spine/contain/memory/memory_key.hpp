// SPDX-License-Identifier: Apache-2.0
// Memory protection keys (x86 PKU): a thread's write permission for certain pages, changed without a system call.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"

namespace lithe::contain {

// One thread's access to the pages of one key, as two values of its PKRU register.
// Contract: RT · one thread. Without PKU `used` stays false, and the functions do nothing.
struct MemoryKey {
  bool used = false;
  std::uint32_t open = 0;    // may write
  std::uint32_t closed = 0;  // may only read

#if defined(__x86_64__)
  // The calling thread's PKRU with `key` open or closed and all other keys unchanged.
  static MemoryKey of(int key) LITHE_RT {
    const std::uint32_t no_access = 1u << (2 * key);
    const std::uint32_t no_write = 2u << (2 * key);
    const std::uint32_t open = read() & ~(no_access | no_write);
    return {true, open, open | no_write};
  }
  void allow_writes() const LITHE_RT {
    if (used) write(open);
  }
  void forbid_writes() const LITHE_RT {
    if (used) write(closed);
  }

 private:
  // Written as bytes: the compiler accepts the mnemonics only with a target option for all machines. The memory clobber
  // keeps stores from moving across.
  static std::uint32_t read() LITHE_RT {
    std::uint32_t value = 0, high = 0;
    asm volatile(".byte 0x0f, 0x01, 0xee" : "=a"(value), "=d"(high) : "c"(0));  // rdpkru
    return value;
  }
  static void write(std::uint32_t value) LITHE_RT {
    asm volatile(".byte 0x0f, 0x01, 0xef" : : "a"(value), "c"(0), "d"(0) : "memory");  // wrpkru
  }
#else
  static MemoryKey of(int) LITHE_RT { return {}; }
  void allow_writes() const LITHE_RT {}
  void forbid_writes() const LITHE_RT {}
#endif
};

}  // namespace lithe::contain
