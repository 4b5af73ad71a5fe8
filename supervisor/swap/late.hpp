// SPDX-License-Identifier: Apache-2.0
// Certificates that could not be written: they wait until the disk has room.
#pragma once

#include <cstdint>
#include <map>

#include "supervisor/swap/record.hpp"

namespace lithe::swap {

// Contract: one thread · holds kMost certificates; the oldest goes when there are more.
class LateRecords {
 public:
  static constexpr std::size_t kMost = 256;
  static constexpr std::int64_t kPauseNs = 1'000'000'000;  // between two tries

  // Stores the newest version of a certificate that has no file.
  void hold(std::uint64_t request_id, Json certificate);
  // Writes waiting certificates until one fails again; most calls do nothing.
  void retry(RecordBook& book, std::int64_t now_ns);
  std::size_t waiting() const;

 private:
  struct Late {
    Json certificate;  // null = it has been written
    RecordBook::Page page;
  };
  std::map<std::uint64_t, Late> late_;
  std::int64_t next_try_ns_ = 0;
};

}  // namespace lithe::swap
