// SPDX-License-Identifier: Apache-2.0
// The exchange point between the Loader and the tick: a swap is one atomic exchange at the end of a tick.
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/law/resident.hpp"

namespace lithe::law {

// Result of a commit, for the event ring.
struct Commit {
  std::uint32_t law_id = 0;
  std::uint32_t previous_id = 0;  // 0 = none
  std::uint64_t request_id = 0;
  std::uint32_t fields_carried = 0;
  // Fields of the candidate that start from their default: the old value is no usable number.
  FieldBits not_carried = 0;
};

enum class Carry : std::uint8_t { named, none };

// Number of earlier laws that stay resident, for a rollback.
inline constexpr std::uint32_t kHistory = 4;
static_assert(kHistory + 3 <= kResidents, "beside them: the active law, the candidate, one on its way out");

// Hands a Resident from the Loader to the tick and back. A Resident has one owner at a time; these three edges move it:
//   offer      pending_ CAS   release  -> take exchange acquire         (the tick sees the finished Resident)
//   withdraw   pending_ exchange acquire, on the Loader's own store     (exactly one of the two exchanges gets it)
//   retire     retired_[i]    release  -> collect_retired exchange acquire (the Loader sees the tick's last write)
// Contract: RT · one Loader thread, one tick thread · both sides wait-free.
class Slot {
 public:
  // --- Loader side ---

  // Stages `candidate`. False when another one is still waiting for its tick.
  bool offer(Resident* candidate) LITHE_RT {
    Resident* none = nullptr;
    // release: partner of the acquire in take(); everything written to *candidate is visible there.
    return pending_.compare_exchange_strong(none, candidate, std::memory_order_release, std::memory_order_relaxed);
  }

  // Takes back a candidate that no tick has committed yet; nullptr when there is none (or the tick has just taken it).
  Resident* withdraw() LITHE_RT { return pending_.exchange(nullptr, std::memory_order_acquire); }

  // A Resident that the tick has retired; nullptr = none. The Loader owns it again.
  Resident* collect_retired() LITHE_RT {
    for (auto& entry : retired_) {
      if (entry.load(std::memory_order_relaxed) == nullptr) continue;  // only a hint; the exchange decides
      // acquire: partner of the release in retire(); the tick's last use of *resident happened before.
      return entry.exchange(nullptr, std::memory_order_acquire);
    }
    return nullptr;
  }

  // The law that runs, 0 = none. The tick may change it at any moment.
  std::uint32_t active_id() const LITHE_RT { return active_id_.load(std::memory_order_acquire); }

  // --- Tick side ---

  Resident* active() LITHE_RT { return active_; }

  // The n-th law before the active one, 1 = the last; nullptr when it is not resident any more.
  Resident* before(std::uint32_t n) LITHE_RT { return n >= 1 && n <= depth_ ? history_[n - 1] : nullptr; }
  std::uint32_t depth() const LITHE_RT { return depth_; }

  // Takes the candidate from the Loader, nullptr when there is none. Next: commit() or refuse().
  Resident* take() LITHE_RT {
    if (pending_.load(std::memory_order_relaxed) == nullptr) return nullptr;  // a hint: keeps the line shared
    // acquire: partner of the release in offer(). Exchange, not load and store: withdraw() may run at the same time.
    return pending_.exchange(nullptr, std::memory_order_acquire);
  }

  // Makes a candidate active. It gets the State fields of the law before it by name, unless it has run in the shadow.
  Commit commit(Resident& candidate, Carry carry = Carry::named) LITHE_RT {
    Commit done{candidate.law_id, active_ == nullptr ? 0 : active_->law_id, candidate.request_id};
    if (carry == Carry::named) carry_into(candidate, done);
    if (active_ != nullptr) {
      if (depth_ == kHistory) retire(history_[--depth_]);
      for (std::uint32_t i = depth_; i > 0; --i) history_[i] = history_[i - 1];
      history_[0] = active_;
      ++depth_;
    }
    make_active(&candidate);
    return done;
  }

  // The active law's state into a candidate that follows it. Without a migration it starts from its defaults.
  void carry_into(Resident& candidate, Commit& done) LITHE_RT {
    const Migrations* planned = active_ == nullptr ? nullptr : candidate.migrations_from(*active_);
    if (planned == nullptr) return;
    done.not_carried = apply_migration(planned->in, active_->state.data(), candidate.state.data());
    done.fields_carried = planned->in.count - static_cast<std::uint32_t>(std::popcount(done.not_carried));
  }

  // Refuses a candidate that was taken: the Loader gets it back.
  void refuse(Resident& candidate) LITHE_RT { retire(&candidate); }

  // Back by `n` laws; those passed over are retired. `named`: fields that both laws have are taken from the leaving
  // law, the rest is as it was when the law was replaced. `none`: the leaving law is not trusted (NaN output, crash),
  // so none of its fields are taken. A field that holds no usable number then starts from its default: `mended`, if
  // given, gets those fields. False when there are not so many laws. Safe in the middle of a tick, between two steps.
  bool rollback(Carry carry = Carry::named, std::uint32_t n = 1, FieldBits* mended = nullptr) LITHE_RT {
    Resident* target = before(n);
    if (target == nullptr) return false;
    FieldBits bits = 0;
    if (const Migrations* planned = active_->migrations_from(*target); planned != nullptr && carry == Carry::named)
      bits = apply_migration(planned->out, active_->state.data(), target->state.data());
    bits |= mend_state(*target->descriptor, target->state.data());
    if (mended != nullptr) *mended = bits;
    retire(active_);
    for (std::uint32_t i = 0; i + 1 < n; ++i) retire(history_[i]);
    depth_ -= n;
    for (std::uint32_t i = 0; i < depth_; ++i) history_[i] = history_[i + n];
    make_active(target);
    return true;
  }

 private:
  void retire(Resident* resident) LITHE_RT {
    if (resident == nullptr) return;
    // release: partner of the acquire in collect_retired(). The entry is free: a Resident has one index, one owner.
    retired_[resident->index % kResidents].store(resident, std::memory_order_release);
  }

  void make_active(Resident* resident) LITHE_RT {
    active_ = resident;
    active_id_.store(resident->law_id, std::memory_order_release);  // partner: active_id()
  }

  alignas(64) std::atomic<Resident*> pending_{nullptr};
  alignas(64) std::array<std::atomic<Resident*>, kResidents> retired_{};
  std::atomic<std::uint32_t> active_id_{0};
  alignas(64) Resident* active_ = nullptr;  // used by the tick only, as the two below
  std::array<Resident*, kHistory> history_{};
  std::uint32_t depth_ = 0;
};

}  // namespace lithe::law
