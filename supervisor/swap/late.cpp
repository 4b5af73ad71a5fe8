// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/late.hpp"

#include <algorithm>
#include <utility>

namespace lithe::swap {

void LateRecords::hold(std::uint64_t request_id, Json certificate) {
  late_[request_id].certificate = std::move(certificate);
  if (late_.size() > kMost) {
    late_.erase(late_.begin());
  }
}

void LateRecords::retry(RecordBook& book, std::int64_t now_ns) {
  if (now_ns < next_try_ns_ || waiting() == 0) {
    return;
  }
  next_try_ns_ = now_ns + kPauseNs;
  for (auto& [id, late] : late_) {
    if (late.certificate.is_null()) {
      continue;
    }
    if (late.page.path.empty()) {
      const auto page = book.write(late.certificate);
      if (!page) {
        return;
      }
      late.page = *page;
    } else if (!book.rewrite(late.page, late.certificate)) {
      return;
    }
    late.certificate = nullptr;
  }
}

std::size_t LateRecords::waiting() const {
  return static_cast<std::size_t>(
      std::count_if(late_.begin(), late_.end(), [](const auto& each) { return !each.second.certificate.is_null(); }));
}

}  // namespace lithe::swap
