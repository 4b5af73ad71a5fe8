// SPDX-License-Identifier: Apache-2.0
// Protects data that must not change while the robot runs: read-only pages where possible, otherwise hashes that are
// checked repeatedly.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>

#include "spine/core/pinned.hpp"
#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"

namespace lithe::contain {

// Makes the program's own variables (.data, .bss, the linker's tables) read-only while this object exists: a law's
// write there is a fault with its address. Needs a program linked with `-z now`. Variables of libraries stay writable.
// Contract: one, off the tick, after every lazily initialised variable has its value · no variable of the program
// changes while it lives
class SealedStatics {
 public:
  static Result<SealedStatics> seal();
  SealedStatics(SealedStatics&& other) noexcept;
  SealedStatics& operator=(SealedStatics&&) = delete;
  ~SealedStatics();

  std::size_t bytes() const { return bytes_; }

 private:
  SealedStatics(void* from, std::size_t bytes) : from_(from), bytes_(bytes) {}
  void* from_ = nullptr;
  std::size_t bytes_ = 0;
};

inline constexpr std::size_t kMaxConstants = 24;

// Memory that does not change while the robot runs but cannot be read-only: each block is hashed when it is registered,
// and compared on the housekeeping core. Damage is latched: other memory may be damaged too.
// Contract: watch(), forget() and look() off the tick, any thread · damaged() RT, any thread · lies in the protected
// memory
class Constants : Pinned {
 public:
  // Watches `block` until forget(block). `name`: shown to users; must live as long as the program.
  Result<> watch(const char* name, const void* block, std::size_t bytes);
  void forget(const void* block);

  // Checks every block. nullptr when none has changed, else the name of the first changed block.
  const char* look();

  // The block that look() found damaged; nullptr = none. acquire: partner of the release in look().
  const char* damaged() const LITHE_RT { return damaged_.load(std::memory_order_acquire); }

 private:
  struct Block {
    const char* name = nullptr;
    const void* from = nullptr;
    std::size_t bytes = 0;
    std::uint64_t hash = 0;
  };
  std::mutex mutex_;  // never locked by the tick
  std::array<Block, kMaxConstants> blocks_{};
  std::atomic<const char*> damaged_{nullptr};
};

// Unused words beside data that changes: a long stray write there also changes these, and is detected.
// Contract: watched for its whole lifetime
class Canary : Pinned {
 public:
  Canary(Constants& constants, const char* name);
  ~Canary() { constants_.forget(words_.data()); }

 private:
  static constexpr std::size_t kWords = 64;
  Constants& constants_;
  std::array<std::uint64_t, kWords> words_;
};

}  // namespace lithe::contain
