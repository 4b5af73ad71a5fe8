// SPDX-License-Identifier: Apache-2.0
// What every fuzz target has in common: bytes read as choices, choices written as bytes, and the oracle's verdict.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <limits>
#include <span>
#include <string_view>
#include <vector>

#include "spine/hal/core/frame.hpp"

namespace lithe::fuzz {

using Bytes = std::span<const std::uint8_t>;
using Seed = std::vector<std::uint8_t>;
template <class T>
using List = std::initializer_list<T>;  // numbers of this type

// ---- What a target gives (driver.cpp calls it)

// Does with the code under test what the bytes say. Comes back, or require() refutes it.
void run(Bytes bytes);
// Inputs that reach what must be reached: made from the frames that the tests know.
std::vector<Seed> seeds();

// ---- What a target is given

// Ends the program with these words when it does not hold.
void require(bool holds, const char* what);

// Numbers that code breaks on.
inline constexpr std::array<double, 16> kSharp{0.0,
                                               1.0,
                                               -1.0,
                                               0.5,
                                               std::numeric_limits<double>::quiet_NaN(),
                                               std::numeric_limits<double>::infinity(),
                                               -std::numeric_limits<double>::infinity(),
                                               1e300,
                                               -1e300,
                                               3.5e38,
                                               -3.5e38,
                                               1e-300,
                                               2147483648.0,
                                               -2147483649.0,
                                               32768.0,
                                               1e-9};

// The bytes of one input, front to back. What is beyond the end reads as 0.
class Input {
 public:
  explicit Input(Bytes bytes) : rest_(bytes) {}

  bool empty() const { return rest_.empty(); }
  std::uint8_t byte() {
    if (rest_.empty()) return 0;
    const std::uint8_t first = rest_.front();
    rest_ = rest_.subspan(1);
    return first;
  }
  template <class T>
  T number() {
    std::array<std::uint8_t, sizeof(T)> raw{};
    for (std::uint8_t& each : raw) each = byte();
    T value;
    std::memcpy(&value, raw.data(), sizeof(T));
    return value;
  }
  // At most so many.
  Bytes bytes(std::size_t most) {
    const Bytes taken = rest_.first(std::min(most, rest_.size()));
    rest_ = rest_.subspan(taken.size());
    return taken;
  }
  std::string_view text(std::size_t most) {
    const Bytes taken = bytes(most);
    return {reinterpret_cast<const char*>(taken.data()), taken.size()};
  }
  // One of kSharp, a thousandth of a small whole number, or any eight bytes.
  double real() {
    const std::uint8_t kind = byte();
    if (kind < kSharp.size()) return kSharp[kind];
    return kind < 0x80 ? 1e-3 * number<std::int16_t>() : number<double>();
  }
  // An id of `likely`, or any other. Also what no bus can carry, when `any_size`.
  hal::Frame frame(std::span<const std::uint32_t> likely, bool any_size = false) {
    hal::Frame frame;
    const std::uint8_t flags = byte();
    const std::uint8_t which = byte();
    frame.id = which < likely.size() ? likely[which] : number<std::uint32_t>() & hal::kLargestId;
    frame.extended = (flags & 1) != 0 || frame.id > hal::kLargestStandardId;
    frame.fd = (flags & 2) != 0;
    frame.brs = frame.fd && (flags & 4) != 0;
    const std::uint8_t size = byte();
    const Bytes data = bytes(std::min<std::size_t>(size, frame.fd || any_size ? hal::kMaxPayload : 8));
    std::copy(data.begin(), data.end(), frame.data.begin());
    const bool as_said = any_size && (flags & 8) != 0;
    frame.size = as_said ? size : static_cast<std::uint8_t>(hal::fd_size(data.size()));
    return frame;
  }

 private:
  Bytes rest_;
};

// Writes what Input reads.
class Script {
 public:
  Script& byte(unsigned value) {
    bytes_.push_back(static_cast<std::uint8_t>(value));
    return *this;
  }
  template <class T>
  Script& number(T value) {
    const auto* raw = reinterpret_cast<const std::uint8_t*>(&value);
    bytes_.insert(bytes_.end(), raw, raw + sizeof(T));
    return *this;
  }
  Script& text(std::string_view words) {
    bytes_.insert(bytes_.end(), words.begin(), words.end());
    return *this;
  }
  Script& real(double value) { return byte(0xff).number(value); }
  Script& frame(const hal::Frame& frame) {
    byte((frame.extended ? 1U : 0U) | (frame.fd ? 2U : 0U) | (frame.brs ? 4U : 0U));
    byte(0xff).number(frame.id).byte(frame.size);
    bytes_.insert(bytes_.end(), frame.data.begin(), frame.data.begin() + frame.size);
    return *this;
  }
  operator Seed() const { return bytes_; }  // NOLINT(google-explicit-constructor): a seed is what it is for

 private:
  Seed bytes_;
};

inline bool same(const hal::Frame& a, const hal::Frame& b) {
  const auto x = a.payload(), y = b.payload();
  return a.id == b.id && a.extended == b.extended && a.fd == b.fd && a.brs == b.brs &&
         std::equal(x.begin(), x.end(), y.begin(), y.end());
}

}  // namespace lithe::fuzz
