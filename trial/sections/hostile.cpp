// SPDX-License-Identifier: Apache-2.0
// Hostile inputs. Any output is accepted, because the guard can replace it; but the law must return in time.
#include <algorithm>
#include <array>
#include <limits>

#include "spine/law/dry_inputs.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kMost = std::numeric_limits<double>::max();
constexpr double kDenormal = 1e-310;

struct Value {
  const char* name;
  double value;
};
constexpr std::array kValues = std::to_array<Value>({{"NaN", kNan},
                                                     {"infinite", kInf},
                                                     {"-infinite", -kInf},
                                                     {"1e308", kMost},
                                                     {"-1e308", -kMost},
                                                     {"1e9", 1e9},
                                                     {"-1e9", -1e9},
                                                     {"1e5", 1e5},
                                                     {"denormal", kDenormal},
                                                     {"-0", -0.0}});
constexpr std::array kTimes = std::to_array<Value>({{"NaN", kNan},
                                                    {"0", 0},
                                                    {"-1 ms", -1e-3},
                                                    {"infinite", kInf},
                                                    {"1e9 s", 1e9},
                                                    {"1e-12 s", 1e-12},
                                                    {"denormal", kDenormal}});

constexpr std::array kClock =
    std::to_array<std::pair<const char*, double Tick::*>>({{"dt_s", &Tick::dt_s},
                                                           {"t_s", &Tick::t_s},
                                                           {"sample_age_s", &Tick::sample_age_s},
                                                           {"brain_age_s", &Tick::brain_age_s}});

class HostileInputs {
 public:
  explicit HostileInputs(TrialContext& context) : context_(context) {}

  bool run() {
    for (const JointInput& field : kJointInputs) {
      for (const Value& value : kValues) {
        context_.doing("%s = %s", field.name, value.name);
        if (!one([&](Tick& tick, int) { fill(tick, field.values, value.value); })) return false;
      }
    }
    for (const auto& [name, time] : kClock) {
      for (const Value& value : kTimes) {
        context_.doing("%s = %s", name, value.name);
        if (!one([&](Tick& tick, int) { tick.*time = value.value; })) return false;
      }
    }
    return everything_at_once() && inputs() && limits_and_jumps() && counters();
  }

 private:
  void fill(Tick& tick, JointArray Tick::* values, double value) const {
    std::fill_n((tick.*values).begin(), context_.joints(), value);
  }

  bool everything_at_once() {
    for (const Value& value : kValues) {
      context_.doing("every measured value and setpoint %s", value.name);
      const bool fine = one([&](Tick& tick, int) {
        for (const JointInput& field : kJointInputs) fill(tick, field.values, value.value);
        tick.sensor.fill(value.value);
      });
      if (!fine) return false;
    }
    return true;
  }

  // What the Brain may send: the Spine lets nothing else through.
  bool inputs() {
    const std::vector<robot::InputConfig>& all = context_.setup.robot.inputs;
    if (all.empty()) return true;
    context_.doing("every input from one end of its range to the other");
    return one([&](Tick& tick, int k) {
      for (std::size_t i = 0; i < all.size(); ++i) tick.input[i] = k % 2 == 0 ? all[i].max : all[i].min;
    });
  }

  // Extreme but possible states, and samples of a loose cable.
  bool limits_and_jumps() {
    const auto at_limit = [this](Tick& tick, int k, bool jump) {
      const double side = k % 2 == 0 ? 1 : -1;
      for (std::uint32_t j = 0; j < context_.joints(); ++j) {
        const robot::JointConfig& joint = context_.setup.robot.joints[j];
        tick.position_rad[j] = side > 0 ? joint.position_max_rad : joint.position_min_rad;
        tick.velocity_rad_s[j] = side * joint.velocity_max_rad_s;
        if (!jump) continue;
        tick.position_rad[j] = side * 100;
        tick.velocity_rad_s[j] = -side * 1000;
      }
    };
    context_.doing("every joint at its limits");
    if (!one([&](Tick& tick, int k) { at_limit(tick, k, false); })) return false;
    context_.doing("jumps by 200 rad from tick to tick");
    return one([&](Tick& tick, int k) { at_limit(tick, k, true); });
  }

  bool counters() {
    context_.doing("stale sample, no Brain");
    const auto stale = [](Tick& tick, int) {
      tick.flags = ~0u;
      tick.sample_age_s = tick.brain_age_s = kInf;
    };
    if (!one(stale)) return false;
    context_.doing("the first tick again and again");
    if (!one([](Tick& tick, int) { tick.tick = 0, tick.t_ns = 0, tick.t_s = 0; })) return false;
    context_.doing("the largest tick number");
    return one([](Tick& tick, int) { tick.tick = ~0ull, tick.t_ns = std::numeric_limits<std::int64_t>::max(); });
  }

  // A fresh law, one ordinary step, two of these, two ordinary ones.
  template <class Change>
  bool one(Change change) {
    double slowest_ns = five_steps(change);
    ++context_.report.hostile_cases;
    if (after_finite_ == 0) ++context_.report.hostile_not_recovered;
    if (!during_finite_) ++context_.report.hostile_not_finite;
    // The process may have been preempted: only a step that is slow each time counts against the law.
    for (int again = 0; again < 4 && slowest_ns > limit_ns(); ++again)
      slowest_ns = std::min(slowest_ns, five_steps(change));
    if (const char* damage = context_.one.damage(); *damage != '\0')
      return context_.refuse("%s with %s: check an index before it is used", damage, context_.report.doing.data());
    if (slowest_ns > context_.report.hostile_worst_ns) {
      context_.report.hostile_worst_ns = slowest_ns;
      context_.report.hostile_slowest = context_.report.doing;
    }
    if (slowest_ns <= limit_ns()) return true;
    return context_.refuse(
        "a step takes %.0f us with %s; its budget is %.0f us: bound every loop by a number, whatever the "
        "input",
        slowest_ns / 1e3, context_.report.doing.data(), limit_ns() / 1e3);
  }
  double limit_ns() const { return static_cast<double>(context_.budget_ns); }

  template <class Change>
  double five_steps(Change& change) {
    double slowest_ns = 0;
    during_finite_ = true;
    context_.one.reset();
    for (int k = 0; k < 5; ++k) {
      const bool changed = k == 1 || k == 2;
      law::dry_input(tick_, static_cast<std::uint64_t>(k) + 100, context_.joints());
      in_ = tick_;
      if (changed) change(in_, k);
      const double ns = context_.one.step(in_);
      if (changed) slowest_ns = std::max(slowest_ns, ns);
      char bad[64];
      const bool finite = law::outputs_are_finite(context_.one.effort(), context_.one.probes(), context_.law,
                                                  context_.joints(), bad, sizeof bad);
      if (changed && !finite) during_finite_ = false;
      after_finite_ = finite ? 1 : 0;
      ++context_.progress().steps;
    }
    return slowest_ns;
  }

  TrialContext& context_;
  Tick tick_, in_;
  bool during_finite_ = true;
  int after_finite_ = 1;
};

}  // namespace

bool run_hostile(TrialContext& context) { return HostileInputs(context).run(); }

}  // namespace lithe::trial
