// SPDX-License-Identifier: Apache-2.0
// Memory with a fence: what a law writes one byte too far does not go unnoticed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace lithe::trial {

// `bytes` bytes that end at a page no one may touch; the rest of their first page holds a pattern, and a page that no
// one may touch lies before it. A shared pair shows the same bytes twice: writable for us, read-only for the law.
// Contract: makes its memory once, never gives it back (the process is thrown away) · not in the tick
class Guarded {
 public:
  enum class Kind { plain, with_read_only_view };

  // Aborts the process when there is no memory: a trial without fences would mean nothing.
  Guarded(std::size_t bytes, Kind kind);

  std::byte* data() const { return data_; }                // ours
  const std::byte* law_view() const { return law_view_; }  // what the law is given
  std::size_t size() const { return size_; }

  // False when something before the bytes has been overwritten.
  bool fence_intact() const;

 private:
  std::byte* data_ = nullptr;
  std::byte* law_view_ = nullptr;
  std::size_t size_ = 0;
  std::span<std::byte> fence_;
};

}  // namespace lithe::trial
