// SPDX-License-Identifier: Apache-2.0
// What a law could write although nobody should once the robot runs: read-only pages where that is possible, else
// looked at again and again.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <mutex>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"

namespace lithe::contain {

// The program's own variables (.data, .bss, the linker's tables): pages that nobody can write while this lives, so a
// law's write there is a fault with its address. Needs a program that was linked with `-z now`; libraries keep theirs.
// Contract: one, off the tick, after the last variable with a late first value has it · no variable of the program
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

// Memory that does not change while the robot runs and cannot be read-only: a hash of each block is taken when it is
// given, and compared on the housekeeping core. What has changed once stays damaged: nobody knows what else has.
// Contract: watch(), forget() and look() off the tick, any thread · damaged() RT, any thread · lies in the Vault
class Constants {
 public:
  Constants() = default;
  Constants(const Constants&) = delete;
  Constants& operator=(const Constants&) = delete;

  // `name`: for a person, a text that lives as long as the program. Until forget(block).
  Result<> watch(const char* name, const void* block, std::size_t bytes);
  void forget(const void* block);

  // Looks at every block. nullptr when all are as they were, else the name of the first that was found otherwise.
  const char* look();

  // What look() has found so far; nullptr = nothing.
  // acquire: partner of the release in look(); the name is a constant of the program.
  const char* damaged() const LITHE_RT { return damaged_.load(std::memory_order_acquire); }

 private:
  struct Block {
    const char* name = nullptr;
    const void* from = nullptr;
    std::size_t bytes = 0;
    std::uint64_t hash = 0;
  };
  std::mutex mutex_;  // never the tick's
  std::array<Block, kMaxConstants> blocks_{};
  std::atomic<const char*> damaged_{nullptr};
};

// Words of no use to anybody, beside what does change: a run of wrong writes that comes this way goes over them.
// Contract: watched from its first moment to its last
class Canary {
 public:
  Canary(Constants& constants, const char* name);
  Canary(const Canary&) = delete;
  Canary& operator=(const Canary&) = delete;
  ~Canary() { constants_.forget(words_.data()); }

 private:
  static constexpr std::size_t kWords = 64;
  Constants& constants_;
  std::array<std::uint64_t, kWords> words_;
};

}  // namespace lithe::contain
