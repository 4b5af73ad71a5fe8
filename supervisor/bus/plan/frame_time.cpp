// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/frame_time.hpp"

#include <algorithm>
#include <bit>

namespace lithe::hal {
namespace {

constexpr int kStuffAfter = 5;
constexpr int kFixedStuffEvery = 4;
constexpr std::uint32_t kTrailer = 13;  // CRC delimiter, acknowledge and its delimiter, 7 of end, 3 of pause
constexpr std::size_t kClassicPayload = 8;
constexpr std::size_t kCrc17Payload = 16;  // longer frames use CRC-21
constexpr std::uint32_t kPolynomial15 = 0x4599;
constexpr std::uint32_t kPolynomial17 = 0x1685b;
constexpr std::uint32_t kPolynomial21 = 0x102899;

std::uint32_t most_stuffing(std::uint32_t bits) { return bits == 0 ? 0 : (bits - 1) / 4; }

std::size_t wire_size(std::size_t size, bool fd) {
  return fd ? fd_size(std::min(size, kMaxPayload)) : std::min(size, kClassicPayload);
}

std::uint32_t length_code(std::size_t size) {
  if (size <= 8) return static_cast<std::uint32_t>(size);
  if (size <= 24) return 6 + static_cast<std::uint32_t>(size) / 4;
  return size == 32 ? 13 : size == 48 ? 14 : 15;
}

// Start of frame to BRS; to the bit before the length in a classic frame.
std::uint32_t head_bits(const FrameShape& shape) {
  if (shape.fd) return shape.extended ? 36 : 17;
  return shape.extended ? 35 : 15;
}

// Of FD: stuff count, CRC and the fixed stuff bits between them.
std::uint32_t fd_check_bits(std::size_t size) { return size <= kCrc17Payload ? 4 + 17 + 6 : 4 + 21 + 7; }

}  // namespace

FrameShape shape_of(const Frame& frame) {
  return {wire_size(frame.size, frame.fd), frame.extended, frame.fd, frame.fd && frame.brs};
}

std::int64_t duration_ns(const FrameBits& bits, const BitRates& rates) {
  const auto ns = [](std::uint64_t count, std::uint64_t rate) { return (count * 1'000'000'000 + rate - 1) / rate; };
  return static_cast<std::int64_t>(ns(bits.nominal, rates.nominal_hz) + ns(bits.data, rates.data_hz));
}

FrameBits least_bits(const FrameShape& shape) {
  const auto payload = static_cast<std::uint32_t>(8 * wire_size(shape.size, shape.fd));
  FrameBits bits{head_bits(shape) + kTrailer, 0};
  const std::uint32_t rest = shape.fd ? 5 + payload + fd_check_bits(payload / 8) : 4 + payload + 15;
  (shape.fd && shape.brs ? bits.data : bits.nominal) += rest;
  return bits;
}

FrameBits most_bits(const FrameShape& shape) {
  FrameBits bits = least_bits(shape);
  const std::uint32_t head = head_bits(shape);
  const auto payload = static_cast<std::uint32_t>(8 * wire_size(shape.size, shape.fd));
  const std::uint32_t stuffable = head + payload + (shape.fd ? 5 : 4 + 15);
  const std::uint32_t slow = bits.data > 0 ? most_stuffing(head) : most_stuffing(stuffable);
  bits.nominal += slow;
  if (bits.data > 0) bits.data += most_stuffing(stuffable) - slow;
  return bits;
}

FrameImage::FrameImage(const Frame& frame) {
  const bool fd = frame.fd;
  const std::size_t size = wire_size(frame.size, fd);
  crc_width_ = !fd ? 15 : size <= kCrc17Payload ? 17 : 21;
  crc_polynomial_ = !fd ? kPolynomial15 : size <= kCrc17Payload ? kPolynomial17 : kPolynomial21;
  crc_ = fd ? 1U << (crc_width_ - 1) : 0;  // FD starts with a one, so that leading zeros change the CRC
  head(frame, fd);
  const std::size_t known = std::min<std::size_t>(frame.size, size);
  for (std::size_t i = 0; i < size; ++i) field(i < known ? frame.data[i] : 0, 8);
  if (fd)
    fd_tail();
  else
    classic_tail();
  fast_ = false;
  plain(1);  // CRC delimiter
  plain(0);  // acknowledged
  for (std::uint32_t i = 2; i < kTrailer; ++i) plain(1);
}

void FrameImage::head(const Frame& frame, bool fd) {
  field(0, 1);  // start of frame
  if (frame.extended) {
    field(frame.id >> 18 & 0x7ff, 11);
    field(0b11, 2);  // SRR, IDE
    field(frame.id & 0x3ffff, 18);
    field(0, 1);  // no remote request
  } else {
    field(frame.id & 0x7ff, 11);
    field(0, 2);  // no remote request, no extension
  }
  if (fd) {
    field(0b10, 2);  // FDF and the reserved bit behind it
    field(frame.brs ? 1 : 0, 1);
    fast_ = frame.brs;
    field(0, 1);  // ESI: error active
  } else {
    field(0, frame.extended ? 2 : 1);  // reserved
  }
  field(length_code(wire_size(frame.size, fd)), 4);
}

void FrameImage::classic_tail() {
  field(crc_, crc_width_);
  if (run_ < kStuffAfter) return;
  ++stuffed_;
  plain(opposite());
}

// Where the data ends in five equal bits, the first fixed stuff bit takes the dynamic one's place.
void FrameImage::fd_tail() {
  const std::uint32_t count = stuffed_ % 8;
  const std::uint32_t gray = count ^ count >> 1;
  const std::uint32_t counted = gray << 1 | (static_cast<std::uint32_t>(std::popcount(gray)) & 1U);
  for (int i = 3; i >= 0; --i) feed_crc(static_cast<std::uint8_t>(counted >> i & 1U));
  int until_stuff = 0;
  fixed_field(counted, 4, until_stuff);
  fixed_field(crc_, crc_width_, until_stuff);
}

void FrameImage::field(std::uint32_t value, int width) {
  for (int i = width - 1; i >= 0; --i) stuffed_bit(static_cast<std::uint8_t>(value >> i & 1U));
}

void FrameImage::stuffed_bit(std::uint8_t level) {
  if (run_ == kStuffAfter) {
    const std::uint8_t stuff = opposite();
    ++stuffed_;
    if (crc_width_ != 15) feed_crc(stuff);  // in FD the CRC includes stuff bits
    plain(stuff);
    run_ = 1;
  }
  run_ = size_ > 0 && bits_[size_ - 1] == level ? run_ + 1 : 1;
  feed_crc(level);
  plain(level);
}

void FrameImage::fixed_field(std::uint32_t value, int width, int& until_stuff) {
  for (int i = width - 1; i >= 0; --i) {
    if (until_stuff == 0) {
      plain(opposite());
      until_stuff = kFixedStuffEvery;
    }
    plain(static_cast<std::uint8_t>(value >> i & 1U));
    --until_stuff;
  }
}

void FrameImage::plain(std::uint8_t level) {
  bits_[size_++] = level;
  ++(fast_ ? count_.data : count_.nominal);
}

void FrameImage::feed_crc(std::uint8_t level) {
  const std::uint32_t top = crc_ >> (crc_width_ - 1) & 1U;
  crc_ = crc_ << 1 & ((1U << crc_width_) - 1);
  if (top != level) crc_ ^= crc_polynomial_;
}

FrameBits exact_bits(const Frame& frame) { return FrameImage(frame).count(); }

}  // namespace lithe::hal
