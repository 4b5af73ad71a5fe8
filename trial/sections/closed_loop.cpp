// SPDX-License-Identifier: Apache-2.0
// Closed-loop section: two runs of the law with the simulated robot and the guard, and a third one with the State that
// it will carry, if there is any; one second of simulated time each.
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <limits>
#include <string>
#include <vector>

#include "spine/law/clamp_limits.hpp"
#include "trial/sections/sections.hpp"
#include "trial/simulation/simulated_run.hpp"

namespace lithe::trial {
namespace {

// A run lasts kRunSeconds, however fast the processor is. These are the least of the robot's time, for a law whose
// own steps use up their share of the box, and for a robot that takes too long to simulate.
constexpr double kMandatorySeconds = 0.1;
constexpr double kRoughSeconds = 0.5;  // of the rough one: the push, and what comes of it
// The State carried comes from a robot that is elsewhere: what it does until then may be no fault of the law.
constexpr double kSettledSeconds = 0.3;
// A joint is worth a warning when without a law it is so far off, and a law leaves at least this share of that.
constexpr double kWorthASecondLookRad = 0.02;
constexpr double kNoBetter = 0.95;
constexpr double kMostRunMs = 750;  // of the processor's time for one run: who asks does not wait for ever

// The guard limits every law, but a law that it must limit most of the time is not as its author intended.
struct Bound {
  std::uint32_t LoopStats::* count;
  double share;
  const char* what;
  const char* limit;  // of these two
  double robot::JointConfig::*first, robot::JointConfig::*second = first;
};
using robot::JointConfig;
constexpr Bound kSlewBound{&LoopStats::slew_clamped, law::kSlewClampLimit.trial,
                           "changes its torque faster than torque_slew_nm_s allows", "torque_slew_nm_s is %.3g",
                           &JointConfig::torque_slew_nm_s};
constexpr Bound kBounds[] = {
    {&LoopStats::position_clamped, law::kPositionClampLimit.trial, "pushes a joint against its position limit",
     "its limits are %.3g and %.3g rad", &JointConfig::position_min_rad, &JointConfig::position_max_rad},
    {&LoopStats::velocity_clamped, law::kVelocityClampLimit.trial, "drives a joint to its velocity limit",
     "velocity_max_rad_s is %.3g", &JointConfig::velocity_max_rad_s},
    kSlewBound,
    {&LoopStats::torque_clamped, law::kTorqueClampLimit.trial, "asks for more than torque_max_nm",
     "torque_max_nm is %.3g", &JointConfig::torque_max_nm},
};

// A robot that leaves its limits without a law is stopped in any case; a law must not make this earlier. The same for a
// shaking joint.
bool goes_on(TrialContext& context, const LoopStats& law, const LoopStats& alone, const char* where) {
  if (law.fault != 0 && (alone.fault == 0 || law.fault_tick < alone.fault_tick)) {
    std::array<char, 64> otherwise{"nothing happened"};
    if (alone.fault != 0) std::snprintf(otherwise.data(), otherwise.size(), "it took %u ticks", alone.fault_tick);
    return context.refuse("%s the guard had to stop it after %u ticks (%s); without a law %s", where, law.fault_tick,
                          fault_words(context.setup.robot, law).data(), otherwise.data());
  }
  if (law.tremor == 0 || (alone.tremor == law.tremor && alone.tremor_joint == law.tremor_joint)) return true;
  const robot::JointConfig& shaking = context.setup.robot.joints[law.tremor_joint];
  const char* joint = shaking.name.c_str();
  if (law.tremor == static_cast<std::uint32_t>(law::Tremor::Finding::Kind::chatter)) {
    return context.refuse(
        "%s the torque of joint %s jumps up and down by %.2g N m, %.0f times a second (after %u ticks; from %.2g N m "
        "on, %.0f are too many): filter what it differentiates, and let no sign of an error switch a torque",
        where, joint, law.tremor_size, law.tremor_hz, law.ticks, law::Tremor::kJumpShare * shaking.torque_max_nm,
        std::min(law::Tremor::kChatterHz, law::Tremor::kChatterOfRate * context.setup.robot.rate_hz));
  }
  return context.refuse(
      "%s joint %s swings to and fro by %.2g rad/s at %.1f Hz without decay (after %u ticks; from %.2g rad/s on, %u "
      "swings are too many)",
      where, joint, law.tremor_size, law.tremor_hz, law.ticks, law::Tremor::kSwingShare * shaking.velocity_max_rad_s,
      law::Tremor::kMostSwings);
}

// "joint wrist most of all (tick 512: wanted 12.3 N m, got 0.6, at 0.4 rad and 3.1 rad/s; torque_max_nm is 0.6)".
std::array<char, 240> held_words(const robot::RobotConfig& robot, const LoopStats& law, const Bound& bound) {
  const robot::JointConfig& joint = robot.joints[law.held_joint];
  std::array<char, 80> limit{};
  std::snprintf(limit.data(), limit.size(), bound.limit, joint.*bound.first, joint.*bound.second);
  std::array<char, 240> text{};
  std::snprintf(text.data(), text.size(),
                "joint %s most of all (tick %u: wanted %.3g N m, got %.3g, at %.3g rad and %.3g rad/s; %s)",
                joint.name.c_str(), law.held.tick, law.held.wanted_nm, law.held.given_nm, law.held.position_rad,
                law.held.velocity_rad_s, limit.data());
  return text;
}

bool is_within(TrialContext& context, const Bound& bound, const LoopStats& law, const LoopStats& alone,
               const char* where) {
  const double share = law.*bound.count / std::max(1.0, static_cast<double>(law.ticks));
  // What happened before that run was broken off is no excuse for all of a longer one.
  const double anyway =
      alone.*bound.count / std::max({1.0, static_cast<double>(alone.ticks), static_cast<double>(law.ticks)});
  if (share <= bound.share + anyway) return true;
  return context.refuse("%s it %s in %.0f %% of %u ticks (at most %.0f %%), %s", where, bound.what, 100 * share,
                        law.ticks, 100 * (bound.share + anyway), held_words(context.setup.robot, law, bound).data());
}

constexpr const char* kPlain = "with the simulated robot";

bool judge(TrialContext& context) {
  const LoopStats &law = context.report.loop, &alone = context.setup.plain.baseline;
  return goes_on(context, law, alone, kPlain) && std::ranges::all_of(kBounds, [&](const Bound& bound) {
           return is_within(context, bound, law, alone, kPlain);
         });
}

// Its baseline, and what the whole run takes of the processor [ms].
double run_baseline(const TrialSetup& setup, SimulatedRobot& simulated, bool rough) {
  const std::clock_t from = std::clock();  // processor time of this process, so that other load does not count
  const auto took_ms = [from] { return 1e3 * static_cast<double>(std::clock() - from) / CLOCKS_PER_SEC; };
  simulated.run_ticks = std::numeric_limits<std::uint32_t>::max();
  SimulatedRun run(setup.robot, simulated, rough);
  const std::uint32_t whole = run.stats.whole_ticks;
  const std::uint32_t least = run.ticks_in(rough ? kRoughSeconds : kMandatorySeconds);
  NoTorque no_torque;
  bool goes_on = true;
  do {
    goes_on = run.tick(no_torque);
  } while (goes_on && run.stats.ticks < whole && (run.stats.ticks < least || took_ms() < kMostRunMs));
  simulated.baseline = run.stats;
  const double tick_ms = took_ms() / run.stats.ticks;
  // The guard may have broken it off: a law may keep the robot going to the end.
  const double most = std::clamp(kMostRunMs / tick_ms, 1.0 * least, 1.0 * whole);
  simulated.run_ticks = goes_on ? run.stats.ticks : static_cast<std::uint32_t>(most);
  return tick_ms * simulated.run_ticks;
}

// The law under trial.
struct LawUnderTrial final : TorqueSource {
  explicit LawUnderTrial(LawHarness& on) : harness(on) {}
  void step(const Tick& in, Effort& effort) LITHE_RT override {
    took_ns = harness.step(in);
    effort = harness.effort();
  }
  LawHarness& harness;
  double took_ns = 0;
};

enum class Start : std::uint8_t { fresh, with_carried_state };

// False: an output was not sound, and it is refused. What bounds it is the law's own time: what the robot takes, and
// whether the machine is slow or busy, is no reason to look at less of the law.
bool run_law(TrialContext& context, SimulatedRun& run, double mandatory_s, const char* where, LoopStats& stats,
             Start start = Start::fresh) {
  const auto step_at_most_ns = static_cast<double>(context.budget_ns);  // the rest of a longer one the machine took
  const double most_ns = 0.5 * static_cast<double>(context.law_ns);     // half for each run
  double law_ns = 0;
  context.one.reset();
  if (start == Start::with_carried_state) context.recording.carry(context.law, context.one.state());
  LawUnderTrial law(context.one);
  bool going = true;
  while (going && !run.over()) {
    if (run.stats.ticks >= run.ticks_in(mandatory_s) && law_ns > most_ns) break;
    context.doing("tick %u %s", run.stats.ticks, where);
    going = run.tick(law);
    law_ns += std::min(law.took_ns, step_at_most_ns);
    if (!context.sound(context.one)) return false;
    stats = run.stats;
    ++context.progress().steps;
  }
  return true;
}

// What a short run has not seen.
void warn_if_short(const LoopStats& law, const SimulatedRobot& simulated, const char* which,
                   std::vector<std::string>& found) {
  if (law.ticks == 0 || law.ticks >= law.whole_ticks || law.fault != 0 || law.tremor != 0) return;
  found.push_back(fmt::format("tried for {:.2g} s only, not {:.2g} s, in the {} run: {}",
                              kRunSeconds * law.ticks / law.whole_ticks, kRunSeconds, which,
                              law.ticks < simulated.run_ticks ? "its steps use up the trial's box (--box)"
                                                              : "this robot takes too long to simulate"));
}

constexpr const char* kCarried = "with the State that it will carry from the law that runs";

bool stopped_early(const LoopStats& law) {
  return law.fault != 0 && law.fault_tick < kSettledSeconds / kRunSeconds * law.whole_ticks;
}

// What a law does by the State that it carries, and a fresh one does not show: it shakes a joint, or drives its torque
// to and fro. Where the joints are is another matter (warnings()).
bool runs_with_carried_state(TrialContext& context) {
  LoopStats& law = context.report.carried;
  context.doing("the State that it will carry");
  context.one.reset();
  context.report.carried_fields = context.recording.carry(context.law, context.one.state());
  if (context.report.carried_fields == 0) return true;
  SimulatedRun run(context.setup.robot, context.setup.carried, false);
  bool fine = run_law(context, run, kRoughSeconds, "of the run with the State that it will carry", law,
                      Start::with_carried_state);
  if (fine && !stopped_early(law)) {
    const LoopStats& alone = context.setup.carried.baseline;
    fine = goes_on(context, law, alone, kCarried) && is_within(context, kSlewBound, law, alone, kCarried);
  }
  if (!fine) context.report.sums = run.sums;
  return fine;
}

constexpr const char* kRough =
    "with the simulated robot pushed, 20 % heavier, its sensors noisy and everything one tick later,";

}  // namespace

bool run_loop(TrialContext& context) {
  SimulatedRun plain(context.setup.robot, context.setup.plain, false);
  const bool fine = run_law(context, plain, kMandatorySeconds, kPlain, context.report.loop) && judge(context);
  context.report.sums = plain.sums;
  if (!fine) return false;
  SimulatedRun rough(context.setup.robot, context.setup.heavy, true);
  const bool calm = run_law(context, rough, kRoughSeconds, "of the rough run", context.report.rough) &&
                    goes_on(context, context.report.rough, context.setup.heavy.baseline, kRough);
  if (!calm) context.report.sums = rough.sums;
  return calm && runs_with_carried_state(context);
}

std::vector<std::string> warnings(const Report& report, const TrialSetup& setup) {
  std::vector<std::string> found;
  const LoopStats &law = report.loop, &alone = setup.plain.baseline;
  warn_if_short(law, setup.plain, "gentle", found);
  warn_if_short(report.rough, setup.heavy, "rough", found);
  if (report.carried_fields > 0 && stopped_early(report.carried)) {
    found.push_back(
        fmt::format("{} the simulated robot was stopped after {} ticks ({}): does its State fit a robot "
                    "that stands elsewhere?",
                    kCarried, report.carried.fault_tick, fault_words(setup.robot, report.carried).data()));
  }
  if (law.ticks < alone.ticks) return found;  // over the same time only
  for (std::uint32_t j = 0; j < setup.joints(); ++j) {
    const double with_rad = law.joint_rms_error_rad[j], without_rad = alone.joint_rms_error_rad[j];
    if (without_rad < kWorthASecondLookRad || with_rad < kNoBetter * without_rad) continue;
    found.push_back(
        fmt::format("joint {} is no nearer to its setpoint than without a law: {:.3f} rad against {:.3f} (rms) on the "
                    "simulated robot",
                    setup.robot.joints[j].name, with_rad, without_rad));
  }
  return found;
}

Result<> prepare_runs(TrialSetup& setup) {
  setup.robot.guard.soft_start_s = 0;  // a law that is swapped in while the robot moves has none either
  robot::RobotConfig model = setup.robot;
  model.plant.ideal = true;  // what is uncertain about the robot the rough run adds itself
  start_inside(model);
  const robot::RobotConfig heavy = with_payload(model);
  if (auto opened = open_ready(model, setup.plain); !opened) return opened;
  if (auto opened = open_ready(heavy, setup.heavy); !opened) return opened;
  const double plain_ms = run_baseline(setup, setup.plain, false), rough_ms = run_baseline(setup, setup.heavy, true);
  setup.run_ms = static_cast<int>(std::ceil(2 * plain_ms + rough_ms));
  setup.carried.run_ticks = setup.plain.run_ticks;
  setup.carried.baseline = setup.plain.baseline;
  if (auto opened = open_ready(model, setup.carried); !opened) return opened;
  if (auto opened = open_ready(model, setup.plain); !opened) return opened;
  return open_ready(heavy, setup.heavy);
}

}  // namespace lithe::trial
