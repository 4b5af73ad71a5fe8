// SPDX-License-Identifier: Apache-2.0
// The place where the Loader and the tick meet: a swap is one atomic exchange at the end of a tick.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <optional>

#include "spine/core/rt.hpp"
#include "spine/law/resident.hpp"

namespace lithe::law {

// What a commit did, for the event ring.
struct Commit {
  std::uint32_t law_id = 0;
  std::uint32_t previous_id = 0;  // 0 = none
  std::uint64_t request_id = 0;
  std::uint32_t fields_carried = 0;
  std::uint32_t bytes_carried = 0;
};

enum class Carry : std::uint8_t { named, none };

// Hands a Resident from the Loader to the tick and back. A Resident has one owner at a time; these three edges move it:
//   offer      pending_ CAS   release  -> try_commit exchange acquire   (the tick sees the finished Resident)
//   withdraw   pending_ exchange acquire, on the Loader's own store     (exactly one of the two exchanges gets it)
//   retire     retired_[i]    release  -> collect_retired exchange acquire (the Loader sees the tick's last write)
// Contract: RT · one Loader thread, one tick thread · both sides wait-free.
class Slot {
 public:
  // --- Loader side ---

  // Stages `candidate`. False when another one is still waiting for its tick.
  bool offer(Resident* candidate) LITHE_RT {
    Resident* none = nullptr;
    // release: partner of the acquire in try_commit; everything written to *candidate is visible there.
    return pending_.compare_exchange_strong(none, candidate, std::memory_order_release, std::memory_order_relaxed);
  }

  // Takes back a candidate that no tick has committed yet; nullptr when there is none (or the tick was faster).
  Resident* withdraw() LITHE_RT { return pending_.exchange(nullptr, std::memory_order_acquire); }

  // A Resident the tick has let go of, nullptr when there is none. It belongs to the Loader again.
  Resident* collect_retired() LITHE_RT {
    for (auto& place : retired_) {
      if (place.load(std::memory_order_relaxed) == nullptr) continue;  // a hint only; the exchange decides
      // acquire: partner of the release in retire(); the tick's last use of *resident happened before.
      return place.exchange(nullptr, std::memory_order_acquire);
    }
    return nullptr;
  }

  // The two laws a candidate may follow, as law ids; the tick may roll back at any moment, but only between these two.
  struct Seen {
    std::uint32_t active_id, previous_id;
  };
  Seen seen() const LITHE_RT {
    // acquire: partner of the release in publish_ids(). One word, so the pair is never torn.
    const std::uint64_t word = ids_.load(std::memory_order_acquire);
    return {static_cast<std::uint32_t>(word), static_cast<std::uint32_t>(word >> 32)};
  }

  // --- Tick side ---

  Resident* active() LITHE_RT { return active_; }
  Resident* previous() LITHE_RT { return previous_; }

  // Makes the pending candidate active, with the named state of the law it follows. At most one per tick.
  std::optional<Commit> try_commit() LITHE_RT {
    if (pending_.load(std::memory_order_relaxed) == nullptr) return std::nullopt;  // a hint: keeps the line shared
    // acquire: partner of the release in offer(). Exchange, not load and store: withdraw() may run at the same time.
    Resident* candidate = pending_.exchange(nullptr, std::memory_order_acquire);
    if (candidate == nullptr) return std::nullopt;
    Commit commit{candidate->law_id, active_ == nullptr ? 0 : active_->law_id, candidate->request_id, 0, 0};
    if (const Bridge* bridge = candidate->bridge_from(commit.previous_id)) {
      apply_migration(bridge->in, active_->state.data(), candidate->state.data());
      commit.fields_carried = bridge->in.count;
      commit.bytes_carried = bridge->in.bytes;
    }
    retire(previous_);
    previous_ = active_;
    active_ = candidate;
    publish_ids();
    return commit;
  }

  // Back to the previous law. `named`: fields both laws have come from the law that leaves, the rest is as it was when
  // it was replaced. `none`: the law that leaves is not trusted (it put out NaN, it crashed), nothing of it is kept.
  // False when there is no previous law. Safe in the middle of a tick, between two steps.
  bool rollback(Carry carry = Carry::named) LITHE_RT {
    if (previous_ == nullptr) return false;
    if (const Bridge* bridge = active_->bridge_from(previous_->law_id); bridge != nullptr && carry == Carry::named) {
      apply_migration(bridge->out, active_->state.data(), previous_->state.data());
    }
    retire(active_);
    active_ = previous_;
    previous_ = nullptr;
    publish_ids();
    return true;
  }

 private:
  void retire(Resident* resident) LITHE_RT {
    if (resident == nullptr) return;
    // release: partner of the acquire in collect_retired(). The place is free: a Resident has one index, one owner.
    retired_[resident->index % kResidents].store(resident, std::memory_order_release);
  }

  void publish_ids() LITHE_RT {
    const std::uint64_t previous_id = previous_ == nullptr ? 0 : previous_->law_id;
    ids_.store(previous_id << 32 | active_->law_id, std::memory_order_release);  // partner: seen()
  }

  alignas(64) std::atomic<Resident*> pending_{nullptr};
  alignas(64) std::array<std::atomic<Resident*>, kResidents> retired_{};
  std::atomic<std::uint64_t> ids_{0};
  alignas(64) Resident* active_ = nullptr;  // the tick's own
  Resident* previous_ = nullptr;            // the tick's own
};

}  // namespace lithe::law
