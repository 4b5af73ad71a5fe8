// SPDX-License-Identifier: Apache-2.0
// Time that a frame occupies its bus: from its first bit to the end of the three bits of intermission.
//
// The bit rate changes at the sample points of the BRS bit and of the CRC delimiter. Both bits are counted as slow ones
// here: at 1 and 5 Mbit/s a frame with BRS is in truth up to 0.8 us shorter.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "spine/hal/core/frame.hpp"

namespace lithe::hal {

// Number of bits of one frame at each bit rate.
struct FrameBits {
  std::uint32_t nominal = 0;
  std::uint32_t data = 0;  // from ESI to the end of the CRC of a frame with BRS; 0 without

  std::uint32_t total() const { return nominal + data; }
};

struct BitRates {
  std::uint32_t nominal_hz = 1'000'000;
  std::uint32_t data_hz = 5'000'000;  // never below the nominal rate
};

// Everything that decides the length of a frame, except stuff bits.
struct FrameShape {
  std::size_t size = 0;  // bytes of data as on the wire: fd_size() of them
  bool extended = false;
  bool fd = false;
  bool brs = false;
};

FrameShape shape_of(const Frame& frame);

// Rounded up to whole nanoseconds. Both rates are above 0.
std::int64_t duration_ns(const FrameBits& bits, const BitRates& rates);

// Minimum and maximum for a frame of this shape. Maximum: the largest number of stuff bits, as many as possible in the
// slow part.
FrameBits least_bits(const FrameShape& shape);
FrameBits most_bits(const FrameShape& shape);

// One frame, bit by bit, as ISO 11898-1:2015 puts it on the wire (error active, acknowledged): identifier, length,
// data, stuff count, CRC-15, 17 or 21, dynamic and fixed stuff bits, delimiters, end of frame, intermission.
// Contract: pure · any Frame is safe: a classic one carries 8 bytes at most, one with FD is filled up to fd_size()
class FrameImage {
 public:
  static constexpr std::size_t kCapacity = 768;  // the longest frame there is has 736

  explicit FrameImage(const Frame& frame);

  std::span<const std::uint8_t> bits() const { return {bits_.data(), size_}; }  // 0 dominant, 1 recessive
  const FrameBits& count() const { return count_; }
  std::uint32_t dynamic_stuff_bits() const { return stuffed_; }

 private:
  void head(const Frame& frame, bool fd);
  void classic_tail();
  void fd_tail();
  void field(std::uint32_t value, int width);
  void stuffed_bit(std::uint8_t level);
  void fixed_field(std::uint32_t value, int width, int& until_stuff);
  void plain(std::uint8_t level);
  std::uint8_t opposite() const { return bits_[size_ - 1] == 0 ? 1 : 0; }  // of the last bit; there is one
  void feed_crc(std::uint8_t level);

  std::array<std::uint8_t, kCapacity> bits_{};
  std::size_t size_ = 0;
  FrameBits count_;
  bool fast_ = false;
  int run_ = 0;  // equal bits at the end, as the stuffing counts them
  std::uint32_t stuffed_ = 0;
  int crc_width_ = 15;
  std::uint32_t crc_polynomial_ = 0;
  std::uint32_t crc_ = 0;
};

// The exact bits of this frame.
FrameBits exact_bits(const Frame& frame);

}  // namespace lithe::hal
