// SPDX-License-Identifier: Apache-2.0
// A law that is loaded in the Spine: its entry point, and the Spine's memory for its state and params.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "lithe/law.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/arithmetic.hpp"
#include "spine/law/migrate.hpp"

namespace lithe::law {

// Number of laws in memory at once: active, earlier ones, candidate, and those being retired.
inline constexpr std::uint32_t kResidents = 8;

// State migration between this law and one other law, in both directions, planned before the swap.
struct Migrations {
  std::uint32_t peer_id = 0;  // 0 = none
  Migration in;               // the peer's state into this law's, at commit
  Migration out;              // this law's state into the peer's, at rollback
};

// The terms of a swap, in ticks; all 0 = no shadow, no blend, no probation.
struct Terms {
  std::uint32_t budget_ns = 0;        // of one step; 0 = the robot's own
  std::uint32_t shadow_ticks = 0;     // in the shadow of the active law first
  std::uint32_t blend_ticks = 0;      // from the old output to the new one
  std::uint32_t probation_ticks = 0;  // automatic rollback for so long
  double shadow_tolerance_nm = 0;
  double probation_error_ratio = 0;  // 0 = tracking is not judged
  bool shadow_only = false;          // it never commits: its shadow is measured
};

// Contract: RT once offered · owned by exactly one thread at a time: the Loader until Slot::offer and from
// Slot::collect_retired on, the tick in between.
struct Resident {
  const LitheLaw* descriptor = nullptr;
  std::uint32_t index = 0;   // 0..kResidents-1, index in the resident table
  std::uint32_t law_id = 0;  // counts up from 1 for the life of the Spine
  std::uint64_t request_id = 0;
  std::uint64_t source_hash = 0;
  std::int64_t since_ns = 0;       // its first tick, also in the shadow [CLOCK_MONOTONIC]; 0 = none yet
  std::uint32_t slot = 0;          // arena slot of the code, counted from 1; 0 = none
  std::uint32_t code_bytes = 0;    // of the code and constants in it
  std::uint64_t code_address = 0;  // where the slot begins; 0 = no slot
  Terms terms;
  bool unproven = false;  // it was committed on probation, and not confirmed since
  bool marked = false;    // it has stopped the robot, and was not armed again with the word "all the same"
  std::array<Param, kMaxParams> params{};
  std::array<double, kMaxParams> params_before{};   // the values before the last change, for a revert
  std::array<double, kMaxParams> params_trusted{};  // the last confirmed values
  std::array<Migrations, kResidents> migrations{};  // by the peer's index: any of them may be active at the commit
  alignas(64) std::array<std::byte, kMaxStateBytes> state{};

  // Clears `effort`, then runs the law once.
  void step(const Tick& tick, Effort& effort, std::array<double, kMaxProbes>& probes) LITHE_RT {
    effort.clear(tick.joints);
    with_law_arithmetic([&]()
                            LITHE_RT { descriptor->step(&tick, params.data(), state.data(), &effort, probes.data()); });
  }

  // False, and nothing changed, when there is no such param or the value is outside its range.
  bool set_param(std::uint32_t i, double value) LITHE_RT {
    if (i >= descriptor->param_count || i >= kMaxParams) return false;
    if (!(params[i].min <= value && value <= params[i].max)) return false;  // NaN is refused here
    params[i].value = value;
    return true;
  }

  void remember_params() LITHE_RT {
    for (std::uint32_t i = 0; i < kMaxParams; ++i) params_before[i] = params[i].value;
  }
  // Swaps the values of the last remember_params() with those of now.
  void revert_params() LITHE_RT {
    for (std::uint32_t i = 0; i < kMaxParams; ++i) std::swap(params_before[i], params[i].value);
  }

  // The present values are confirmed: later changes that fail are reverted to these.
  void trust_params() LITHE_RT {
    for (std::uint32_t i = 0; i < kMaxParams; ++i) params_trusted[i] = params[i].value;
  }
  // Back to the confirmed values. A later revert does not lead to the values that failed.
  void restore_trusted_params() LITHE_RT {
    for (std::uint32_t i = 0; i < kMaxParams; ++i) params[i].value = params_before[i] = params_trusted[i];
  }

  const Migrations* migrations_from(const Resident& peer) const LITHE_RT {
    const Migrations& planned = migrations[peer.index % kResidents];
    return peer.law_id != 0 && planned.peer_id == peer.law_id ? &planned : nullptr;
  }
};

// Makes `resident` a fresh copy of its law: default state, default params, no migrations.
// Contract: off the tick · allocates nothing · `descriptor` must have passed check_law.
void reset_resident(Resident& resident, const LitheLaw& descriptor);

// Plans the state migration from `peer` to `resident` and back.
// Contract: off the tick.
void plan_migrations(Resident& resident, const Resident& peer);

// Why a descriptor read from an object is invalid; nullptr = valid. A general static text; describe_mismatch gives the
// numbers.
// Contract: reads `law` only, any bytes are safe.
const char* check_law(const LitheLaw& law);

// Writes one line that names what was expected and found. Returns `text`.
const char* describe_mismatch(const LitheLaw& law, char* text, std::size_t size);

}  // namespace lithe::law
