// SPDX-License-Identifier: Apache-2.0
#include "spine/law/resident.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <string_view>

#include "spine/core/text.hpp"

namespace lithe::law {
namespace {

template <std::size_t N>
bool is_text(const char (&text)[N]) {
  return text[0] != '\0' && std::memchr(text, '\0', N) != nullptr;
}

template <std::size_t N>
bool shows(const char (&text)[N]) {
  const std::string_view name(text, ::strnlen(text, N));
  return is_printable(name) && std::ranges::none_of(name, [](char c) { return (c & 0x80) != 0; });
}

// They reach terminals, logs and certificates. ASCII alone: letters of other alphabets may look like a known name.
bool names_are_printable(const LitheLaw& law) {
  bool all = shows(law.name);
  for (std::uint32_t i = 0; i < law.state_count; ++i) all = all && shows(law.state[i].name);
  for (std::uint32_t i = 0; i < law.param_count; ++i) all = all && shows(law.params[i].name);
  for (std::uint32_t i = 0; i < law.probe_count; ++i) all = all && shows(law.probes[i]);
  return all;
}

bool state_is_sound(const LitheLaw& law) {
  for (std::uint32_t i = 0; i < law.state_count; ++i) {
    const LitheStateField& field = law.state[i];
    const std::uint64_t bytes = std::uint64_t{kind_bytes(FieldKind{field.kind})} * field.count;
    if (!is_text(field.name) || bytes == 0 || field.offset + bytes > law.state_size) return false;
  }
  return law.state_size == 0 || law.state_defaults != nullptr;
}

bool params_are_sound(const LitheLaw& law) {
  for (std::uint32_t i = 0; i < law.param_count; ++i) {
    const LitheParam& p = law.params[i];
    const bool finite = std::isfinite(p.min) && std::isfinite(p.max);
    if (!is_text(p.name) || !finite || !(p.min <= p.value && p.value <= p.max)) return false;
  }
  return true;
}

bool is_current(const LitheLaw& law) {
  return law.abi == kLawAbi && law.descriptor_size == sizeof(LitheLaw) && law.tick_size == sizeof(Tick) &&
         law.effort_size == sizeof(Effort) && law.joints == kMaxJoints;
}

}  // namespace

const char* check_law(const LitheLaw& law) {
  if (law.magic != kLawMagic) return "lithe_law is not a law descriptor: end the file with LITHE_LAW(Type, \"name\")";
  if (!is_current(law)) return "the law was compiled against another contract";
  if (law.state_size > kMaxStateBytes || law.state_align > 64) return "State is larger than the Spine's state block";
  if (law.state_count > kMaxStateFields || law.param_count > kMaxParams || law.probe_count > kMaxProbes)
    return "more State fields, Params or Probes than the contract allows";
  if (!is_text(law.name)) return "the law has no name";
  if (!state_is_sound(law)) return "the State description is damaged";
  if (!params_are_sound(law)) return "a Param is outside its own range";
  for (std::uint32_t i = 0; i < law.probe_count; ++i)
    if (!is_text(law.probes[i])) return "the Probes description is damaged";
  if (!names_are_printable(law)) {
    return "a name of the law, or of its State, Params or Probes, is not printable ASCII: no control characters, no "
           "escapes, no letters that only look alike";
  }
  return law.step == nullptr ? "the law has no step" : nullptr;
}

const char* describe_mismatch(const LitheLaw& law, char* text, std::size_t size) {
  if (law.magic == kLawMagic && !is_current(law)) {
    std::snprintf(text, size,
                  "contract mismatch: expected abi %u, %zu joints, Tick %zu B; found abi %u, %u joints, %u B", kLawAbi,
                  kMaxJoints, sizeof(Tick), law.abi, law.joints, law.tick_size);
  } else {
    const char* reason = check_law(law);
    std::snprintf(text, size, "%s", reason == nullptr ? "" : reason);
  }
  return text;
}

void reset_resident(Resident& resident, const LitheLaw& descriptor) {
  const std::uint32_t index = resident.index;
  resident = {};
  resident.index = index;
  resident.descriptor = &descriptor;
  for (std::uint32_t i = 0; i < descriptor.param_count; ++i) {
    const LitheParam& p = descriptor.params[i];
    resident.params[i] = Param{p.value, p.min, p.max};
    resident.params_before[i] = p.value;
  }
  if (descriptor.state_size > 0) std::memcpy(resident.state.data(), descriptor.state_defaults, descriptor.state_size);
}

void plan_migrations(Resident& resident, const Resident& peer) {
  Migrations& planned = resident.migrations[peer.index % kResidents];
  planned.peer_id = peer.law_id;
  planned.in = plan_migration(*peer.descriptor, *resident.descriptor);
  planned.out = plan_migration(*resident.descriptor, *peer.descriptor);
}

}  // namespace lithe::law
