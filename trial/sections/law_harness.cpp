// SPDX-License-Identifier: Apache-2.0
#include "trial/sections/law_harness.hpp"

#include <fenv.h>

#include <algorithm>

namespace lithe::trial {

LawHarness::LawHarness(const LitheLaw& law, std::span<const Param> params, const History& past, const RawClock& clock)
    : law_(law),
      clock_(clock),
      tick_(sizeof(Tick), Guarded::Kind::with_read_only_view),
      params_(params.size_bytes(), Guarded::Kind::with_read_only_view),
      state_(law.state_size, Guarded::Kind::plain),
      effort_(sizeof(Effort), Guarded::Kind::plain),
      probes_(law.probe_count * sizeof(double), Guarded::Kind::plain),
      past_(past.count * sizeof(PastTick), Guarded::Kind::with_read_only_view),
      before_(law.state_size) {
  new (tick_.data()) Tick;
  new (effort_.data()) Effort;
  if (!params.empty()) std::memcpy(params_.data(), params.data(), params.size_bytes());
  if (past.count > 0) std::memcpy(past_.data(), past.ticks, past.count * sizeof(PastTick));
  history_ = {reinterpret_cast<const PastTick*>(past_.law_view()), past.count, past.joints, past.dt_s};
}

void LawHarness::reset(bool with_past) {
  if (law_.state_size > 0) std::memcpy(state_.data(), law_.state_defaults, law_.state_size);
  if (law_.init == nullptr) return;
  const History nothing{history_.ticks + history_.count, 0, history_.joints, history_.dt_s};
  law_.init(with_past ? &history_ : &nothing, params_.law_view(), state_.data());
}

double LawHarness::step(const Tick& in) LITHE_RT {
  std::memcpy(tick_.data(), &in, sizeof in);
  if (!before_.empty()) std::memcpy(before_.data(), state_.data(), before_.size());
  auto* effort = reinterpret_cast<Effort*>(effort_.data());
  auto* probes = reinterpret_cast<double*>(probes_.data());
  effort->clear(kMaxJoints);
  std::fill_n(probes, law_.probe_count, 0.0);
  const std::int64_t from_ns = clock_.now_ns();
  law_.step(reinterpret_cast<const Tick*>(tick_.law_view()), params_.law_view(), state_.data(), effort, probes);
  return static_cast<double>(clock_.now_ns() - from_ns);
}

void LawHarness::repeat(bool trap) {
  if (!before_.empty()) std::memcpy(state_.data(), before_.data(), before_.size());
  Tick again;
  std::memcpy(&again, tick_.data(), sizeof again);
  feclearexcept(FE_ALL_EXCEPT);
  if (trap) feenableexcept(FE_INVALID | FE_DIVBYZERO);
  step(again);
  if (trap) fedisableexcept(FE_ALL_EXCEPT);
}

const std::array<double, kMaxProbes>& LawHarness::probes() {
  std::memcpy(probe_values_.data(), probes_.data(), law_.probe_count * sizeof(double));
  return probe_values_;
}

const char* LawHarness::damage() const {
  if (!state_.fence_intact()) return "it wrote before the beginning of its State";
  if (!effort_.fence_intact()) return "it wrote before the beginning of its Effort";
  if (!probes_.fence_intact()) return "it wrote before the beginning of its Probes";
  return "";
}

}  // namespace lithe::trial
