// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>

#include "spine/law/dry_inputs.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

constexpr std::uint64_t kSteps = 200, kResetAt = 100;

// Fills the stack that the next call uses: a law that reads uninitialised memory gets different values each time.
[[gnu::noinline]] void scribble(std::uint64_t value) {
  std::array<volatile std::uint64_t, 1024> junk;
  for (auto& word : junk) word = value;
}

double largest_difference(const LawHarness& one, const LawHarness& other, std::uint32_t joints) {
  double most = 0;
  for (std::uint32_t j = 0; j < joints; ++j)
    most = std::max(most, std::abs(one.effort().torque_nm[j] - other.effort().torque_nm[j]));
  return most;
}

// A law that has just been started without a past.
bool starts_without_a_past(TrialContext& context) {
  context.doing("its init without a past");
  context.one.reset(false);
  Tick tick;
  for (std::uint64_t k = 0; k < law::kDryStepsAtRest; ++k) {
    law::dry_input(tick, k, context.joints());
    context.one.step(tick);
    if (!context.sound(context.one)) return false;
  }
  return true;
}

}  // namespace

void TrialContext::doing(const char* format, ...) {
  va_list values;
  va_start(values, format);
  std::vsnprintf(report.doing.data(), report.doing.size(), format, values);
  va_end(values);
}

bool TrialContext::refuse(const char* format, ...) {
  va_list values;
  va_start(values, format);
  std::vsnprintf(report.refused.data(), report.refused.size(), format, values);
  va_end(values);
  return false;
}

bool TrialContext::sound(LawHarness& harness) {
  if (const char* damage = harness.damage(); *damage != '\0')
    return refuse("%s (%s): look for an index below zero", damage, report.doing.data());
  char bad[64];
  if (law::outputs_are_finite(harness.effort(), harness.probes(), law, joints(), bad, sizeof bad))
    return within_joints(harness);
  refuse(
      "%s is not finite (%s): look for a division by zero, sqrt or log of a negative number, a sensor that is not "
      "valid (NaN), or a gain that diverges",
      bad, report.doing.data());
  if (can_trap) harness.repeat(true);  // the handler of SIGFPE reports the place, and ends the trial
  return false;
}

bool run_benign(TrialContext& context) {
  context.doing("its init");
  context.one.reset();
  context.other.reset();
  Tick tick;
  context.report.same_bits = 1;
  for (std::uint64_t k = 0; k < kSteps; ++k) {
    context.doing("harmless input %u", static_cast<unsigned>(k));
    law::dry_input(tick, k, context.joints());
    if (k == kResetAt) context.other.reset();  // from here on the two differ by the effect of the state
    scribble(0);
    const double first_ns = context.one.step(tick);
    if (k == 0) context.report.first_ns = first_ns;
    scribble(0x4141'4141'4141'4141);
    context.other.step(tick);
    ++context.progress().steps;
    if (!context.sound(context.one) || !context.sound(context.other)) return false;
    if (k == kResetAt)
      context.report.reset_difference_nm = largest_difference(context.one, context.other, context.joints());
    if (k >= kResetAt || context.same_bits()) continue;
    context.report.same_bits = 0;
    return context.refuse(
        "the same input gave another output the second time (harmless input %u): look for a variable "
        "that is read before it is written, or an address used as a number",
        static_cast<unsigned>(k));
  }
  if (!reads_within_joints(context)) return false;
  return context.law.init == nullptr || starts_without_a_past(context);
}

}  // namespace lithe::trial
