// SPDX-License-Identifier: Apache-2.0
// Bases of what has one place in memory: it is neither copied nor moved.
#pragma once

namespace lithe {

struct Pinned {
  Pinned() = default;
  Pinned(const Pinned&) = delete;
  Pinned& operator=(const Pinned&) = delete;
};

// What has several implementations.
struct Interface : Pinned {
  virtual ~Interface() = default;
};

}  // namespace lithe
