// SPDX-License-Identifier: Apache-2.0
// Guarded memory: detects writes beyond its ends.
#pragma once

#include <cstddef>
#include <span>

namespace lithe::trial {

// `bytes` bytes that end at an inaccessible page. The rest of their first page holds a pattern, and an inaccessible
// page is before it. A shared pair maps the same bytes twice: writable for us, read-only for the law.
// Contract: allocates once, never frees (the process ends after the trial) · not in the tick
class Guarded {
 public:
  enum class Kind { plain, with_read_only_view };

  // Aborts the process when there is no memory: a trial without guard pages would be useless.
  Guarded(std::size_t bytes, Kind kind);

  std::byte* data() const { return data_; }                // ours
  const std::byte* law_view() const { return law_view_; }  // the law's mapping
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
