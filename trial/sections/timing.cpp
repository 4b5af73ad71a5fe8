// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstring>

#include "spine/law/dry_inputs.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

constexpr std::size_t kMandatoryInputs = 50;
constexpr int kRepeats = 3;

double quantile(const std::vector<double>& sorted, double q) {
  const auto rank = static_cast<std::size_t>(std::ceil(q * static_cast<double>(sorted.size())));
  return sorted[std::clamp<std::size_t>(rank, 1, sorted.size()) - 1];
}

}  // namespace

// Each input is run several times from the same state, and the fastest counts: a hypervisor does not interrupt at the
// same place each time, but the law's own work is the same. The longest of all is reported too.
bool run_timing(TrialContext& context) {
  Tick tick;
  context.one.reset();
  std::array<std::byte, kMaxStateBytes> before;
  const std::span<std::byte> state = context.one.state();
  const std::size_t records = context.recording.size();
  auto& times = context.times_ns;
  times.clear();
  while (times.size() < kTimingInputs && (times.size() < kMandatoryInputs || !context.out_of_time())) {
    const std::size_t k = times.size();
    context.doing("input %u of the timing", static_cast<unsigned>(k));
    if (k % 2 == 1 && records > 0)
      context.recording.fill(tick, records - 1 - (k / 2) % records);
    else
      law::dry_input(tick, k, context.joints());
    std::memcpy(before.data(), state.data(), state.size());
    double best_ns = context.one.step(tick);
    context.report.worst_ns = std::max(context.report.worst_ns, best_ns);
    for (int again = 1; again < kRepeats; ++again) {
      std::memcpy(state.data(), before.data(), state.size());
      const double step_ns = context.one.step(tick);
      context.report.worst_ns = std::max(context.report.worst_ns, step_ns);
      best_ns = std::min(best_ns, step_ns);
    }
    times.push_back(best_ns);
    context.progress().steps += kRepeats;
  }
  std::sort(times.begin(), times.end());
  context.report.timing_inputs = static_cast<std::uint32_t>(times.size());
  context.report.p50_ns = quantile(times, 0.5);
  context.report.p999_ns = quantile(times, 0.999);
  context.report.worst_best_of_3_ns = times.back();
  if (context.report.p999_ns <= static_cast<double>(context.budget_ns)) return true;
  return context.refuse(
      "a step takes %.0f us on this board (99.9 %% of %u inputs; half of them %.0f us); its budget is "
      "%.0f us: fewer iterations, smaller matrices, tables instead of functions",
      context.report.p999_ns / 1e3, context.report.timing_inputs, context.report.p50_ns / 1e3,
      static_cast<double>(context.budget_ns) / 1e3);
}

}  // namespace lithe::trial
