// SPDX-License-Identifier: Apache-2.0
#include "spine/contain/memory/constants.hpp"

#include <cstring>
#include <string>

namespace lithe::contain {
namespace {

// Every step is reversible, so two blocks that differ in one word never have the same hash.
std::uint64_t hash_of(const void* from, std::size_t bytes) {
  constexpr std::uint64_t kOdd = 0x9e37'79b9'7f4a'7c15u;
  const auto* at = static_cast<const unsigned char*>(from);
  std::uint64_t hash = bytes;
  while (bytes > 0) {
    std::uint64_t word = 0;
    const std::size_t step = bytes < sizeof word ? bytes : sizeof word;
    std::memcpy(&word, at, step);
    hash = (hash ^ word) * kOdd;
    hash ^= hash >> 32;
    at += step;
    bytes -= step;
  }
  return hash;
}

}  // namespace

Result<> Constants::watch(const char* name, const void* block, std::size_t bytes) {
  const std::lock_guard lock(mutex_);
  for (Block& place : blocks_) {
    if (place.from != nullptr) continue;
    place = {name, block, bytes, hash_of(block, bytes)};
    return done();
  }
  return Error{std::string("nothing more can be watched (kMaxConstants) than ") + std::to_string(blocks_.size()) +
               " blocks: " + name + " is not"};
}

void Constants::forget(const void* block) {
  const std::lock_guard lock(mutex_);
  for (Block& place : blocks_)
    if (place.from == block) place = {};
}

const char* Constants::look() {
  const std::lock_guard lock(mutex_);
  for (const Block& each : blocks_) {
    if (damaged_.load(std::memory_order_relaxed) != nullptr) break;
    // release: partner of the acquire in damaged().
    if (hash_of(each.from, each.bytes) != each.hash) damaged_.store(each.name, std::memory_order_release);
  }
  return damaged_.load(std::memory_order_relaxed);
}

Canary::Canary(Constants& constants, const char* name) : constants_(constants) {
  for (std::size_t i = 0; i < words_.size(); ++i) words_[i] = 0xc0ff'ee00'dead'0000u + i;
  (void)constants_.watch(name, words_.data(), sizeof words_);
}

}  // namespace lithe::contain
