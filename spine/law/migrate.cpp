// SPDX-License-Identifier: Apache-2.0
#include "spine/law/migrate.hpp"

#include <cstring>

namespace lithe::law {
namespace {

std::uint32_t bytes_of(const LitheStateField& field) { return kind_bytes(FieldKind{field.kind}) * field.count; }

bool same_field(const LitheStateField& a, const LitheStateField& b) {
  return a.kind == b.kind && a.count == b.count && std::strncmp(a.name, b.name, sizeof a.name) == 0;
}

}  // namespace

Migration plan_migration(const LitheLaw& from, const LitheLaw& to) {
  Migration plan;
  for (std::uint32_t i = 0; i < to.state_count; ++i) {
    for (std::uint32_t k = 0; k < from.state_count; ++k) {
      if (!same_field(from.state[k], to.state[i])) continue;
      const std::uint32_t bytes = bytes_of(to.state[i]);
      plan.copies[plan.count++] = {from.state[k].offset, to.state[i].offset, bytes};
      plan.bytes += bytes;
      break;
    }
  }
  return plan;
}

void apply_migration(const Migration& plan, const std::byte* from, std::byte* to) LITHE_RT {
  for (std::uint32_t i = 0; i < plan.count && i < plan.copies.size(); ++i) {
    const Copy& copy = plan.copies[i];
    std::memcpy(to + copy.to, from + copy.from, copy.bytes);
  }
}

}  // namespace lithe::law
