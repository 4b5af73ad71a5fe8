// SPDX-License-Identifier: Apache-2.0
// What a step does with the e-stop, commands (those about laws, too), plans and the Brain's heartbeat.
#include <algorithm>
#include <cmath>

#include "spine/plan/check.hpp"
#include "spine/step/step.hpp"

namespace lithe::step {

using wire::CommandKind;
using wire::CommandResult;
using wire::EventKind;
namespace flag = wire::telemetry_flag;

namespace {

// Arming accepts a sample this many ticks old.
constexpr std::uint32_t kStaleTicksToArm = 3;
constexpr std::uint32_t kAllTheSame = 1;  // of an arm: also a law that has stopped the robot

// A robot that brakes for `disarm` is off when it has been at rest for so long, or after the second time.
constexpr double kRestS = 0.02;
constexpr double kMostBrakingS = 3.0;

constexpr EventKind event_of(CommandKind kind) LITHE_RT {
  switch (kind) {
    case CommandKind::arm:
      return EventKind::armed;
    case CommandKind::disarm:
      return EventKind::disarmed;
    case CommandKind::hold:
      return EventKind::held;
    case CommandKind::reset:
      return EventKind::reset;
    case CommandKind::recover:
      return EventKind::recovering;
    default:
      return EventKind::estop;
  }
}

}  // namespace

void ControlStep::listen(const Input& in) LITHE_RT {
  watch_memory(in.damaged);
  if (in.estop_pressed && mode_.press_estop()) report_.event(EventKind::estop, 0, 0, 0, "the e-stop was pressed");
  if (in.command != nullptr) obey(in);
  if (mode_.brakes()) switch_off_at_rest(in);
  watch_brain(in);
  if (in.plan != nullptr)
    take_plan(*in.plan);
  else if (in.plan_torn)
    miss_plan();
  if (in.inputs != nullptr) take_inputs(*in.inputs);
}

// The housekeeping core found damaged memory: the process cannot be trusted any more, so the robot stops.
void ControlStep::watch_memory(const char* damaged) LITHE_RT {
  if (damaged == nullptr || !memory_whole_) return;
  memory_whole_ = false;
  EventText words;
  words << wire::to_string(wire::Fault::memory_damaged) << ": " << damaged;
  report_.event(EventKind::memory_damaged, laws_.active_id(), 0, 0, words.text());
  fail(wire::Fault::memory_damaged, words.text());
}

void ControlStep::obey(const Input& in) LITHE_RT {
  const wire::Command& command = *in.command;
  // Parameters that nobody has tried: only while there is nobody who could.
  const bool untried = in.untried && static_cast<CommandKind>(command.kind) == CommandKind::set_params;
  const CommandResult result = report_.answer = untried ? CommandResult::refused_untried : execute(in);
  if (result == CommandResult::done) return;
  report_.event(
      EventKind::command_refused, static_cast<std::uint32_t>(result), command.request_id,
      static_cast<double>(command.kind),
      untried ? "parameters in the Brain's mailbox: ask the supervisor, which tries them" : wire::to_string(result));
}

CommandResult ControlStep::execute(const Input& in) LITHE_RT {
  const wire::Command& command = *in.command;
  switch (const auto kind = static_cast<CommandKind>(command.kind); kind) {
    case CommandKind::set_params:
      return laws_.set_params(command);
    case CommandKind::rollback:
      return laws_.roll_back(command);
    case CommandKind::revert_params:
      return laws_.revert_params(command);
    case CommandKind::sim_reset:
      return reset_simulation(command);
    default:
      return change_mode(kind, in);
  }
}

Conditions ControlStep::conditions(const Input& in) const LITHE_RT {
  const hal::ActuatorState& sample = in.sample;
  // One late exchange does not refuse the command: the previous sample is only a few milliseconds old.
  bool all_fresh = sample.sample_ns != 0 && stale_ticks_ <= kStaleTicksToArm;
  // The slew bound of the first torque starts at zero, so every drive must have got the "off" command.
  if (mode_.mode() == wire::Mode::disarmed) all_fresh = all_fresh && drives_.got_off();
  bool homed = true, inside = true, drive_fault = false;
  for (std::uint32_t j = 0; j < in_.joints; ++j) {
    if (mode_.law_runs() && guard_.stopped(j)) continue;  // other groups may continue
    namespace bit = wire::joint_status;
    constexpr std::uint32_t kReportsFault = bit::kFault | bit::kWatchdog;
    drive_fault = drive_fault || (sample.status[j] & kReportsFault) != 0;
    all_fresh = all_fresh && (sample.status[j] & (bit::kFresh | bit::kNotReady | kReportsFault)) == bit::kFresh;
    homed = homed && (!robot_.joints[j].must_be_homed || (sample.status[j] & wire::joint_status::kNotHomed) == 0);
    inside = inside && guard_.recovery().inside(j, sample.position_rad[j]);
  }
  return {laws_.active() != nullptr,
          all_fresh,
          drive_fault,
          homed,
          in.estop_pressed,
          inside,
          memory_whole_,
          moves(in),
          laws_.marked() && (in.command == nullptr || in.command->count != kAllTheSame)};
}

bool ControlStep::moves(const Input& in) const LITHE_RT {
  for (std::uint32_t j = 0; j < in_.joints; ++j)
    if (!(std::abs(in.sample.velocity_rad_s[j]) < guard::Guard::kAtRestRadS)) return true;
  return false;
}

void ControlStep::switch_off_at_rest(const Input& in) LITHE_RT {
  const auto seconds = [&](std::uint64_t ticks) LITHE_RT { return static_cast<double>(ticks) * in_.dt_s; };
  braking_.ticks_at_rest = moves(in) ? 0 : braking_.ticks_at_rest + 1;
  const bool rests = seconds(braking_.ticks_at_rest) >= kRestS;
  if (++braking_.ticks; !rests && seconds(braking_.ticks) < kMostBrakingS) return;
  mode_.switch_off();
  // A drive that reports its fault while it brakes has latched it again.
  if (braking_.event == event_of(CommandKind::reset)) guard_.forget_faults();
  EventText words;
  words << (rests ? "braked to rest for " : "off while a joint still moved, after braking for ");
  words.number(seconds(braking_.ticks - braking_.ticks_at_rest), 3) << " s";
  report_.event(braking_.event, 0, braking_.request_id, 0, words.text());
}

CommandResult ControlStep::change_mode(CommandKind kind, const Input& in) LITHE_RT {
  const wire::Mode before = mode_.mode();
  Conditions now = conditions(in);
  if (kind == CommandKind::disarm && in.command->count != 0) now.moves = false;
  const CommandResult result = mode_.apply(kind, now);
  if (result != CommandResult::done) return result;
  // Drives that are off: the slew bound starts at zero torque, and the setpoint starts at the measured position.
  if (before == wire::Mode::disarmed) guard_.reset_output();
  if (kind == CommandKind::arm && before != wire::Mode::active && before != wire::Mode::hold) laws_.begin();
  if (kind == CommandKind::reset) {
    guard_.forget_faults();
    drives_.clear_faults();
  }
  if (kind == CommandKind::recover) {
    guard_.forget_faults();
    guard_.start_recovery();
  }
  if (mode_.mode() == wire::Mode::hold) plan_.stop(in.now_ns);
  if (mode_.brakes())  // its event follows when the drives are off
    braking_ = {.request_id = in.command->request_id, .event = event_of(kind)};
  else
    report_.event(event_of(kind), 0, in.command->request_id, 0, "");
  return result;
}

// `hold`, but from where the joints are.
void ControlStep::hold_here(const Input& in) LITHE_RT {
  if (mode_.apply(CommandKind::hold, conditions(in)) != CommandResult::done) return;
  plan_.hold_at(in.sample.position_rad);
  report_.event(EventKind::held, 0, 0, 0, "the law before holds the joints where they are; arm follows plans again");
}

// Puts simulated joints back to their start, as a person could with drives that are off.
CommandResult ControlStep::reset_simulation(const wire::Command& command) LITHE_RT {
  if (!drives_.simulated()) return CommandResult::refused_not_simulated;
  if (mode_.mode() != wire::Mode::disarmed) return CommandResult::refused_mode;
  drives_.reset_simulation();
  report_.event(EventKind::sim_reset, 0, command.request_id, 0, "");
  return CommandResult::done;
}

void ControlStep::watch_brain(const Input& in) LITHE_RT {
  const std::int64_t age_ns = in.brain_age_ns;
  const bool stale = age_ns < 0 || static_cast<double>(age_ns) > robot_.brain.stale_after_s * 1e9;
  if (stale == brain_stale_) return;
  brain_stale_ = stale;
  // The rest of a stale Brain's plan is dropped. With on_stale = "safe_stop" the guard stops the robot instead.
  const bool stops = stale && mode_.mode() == wire::Mode::active && robot_.brain.on_stale == robot::StaleAction::hold;
  if (stops) plan_.stop(in.now_ns);
  report_.event(stale ? EventKind::brain_stale : EventKind::brain_fresh, 0, 0, static_cast<double>(age_ns) * 1e-9,
                !stale  ? "the Brain is back"
                : stops ? "no sign of life: the setpoint slows down and holds"
                        : "no sign of life");
}

void ControlStep::take_plan(const wire::Plan& plan) LITHE_RT {
  if (mode_.mode() != wire::Mode::active)  // a plan from before arming is dropped
    return answer(plan, plan::decision(wire::PlanReject::mode, static_cast<double>(mode_.mode())));
  const wire::Plan* taken = &plan;
  if (guard_.any_stopped()) {
    resting_plan_ = plan;
    for (std::uint32_t j = 0; j < in_.joints; ++j)
      if (guard_.stopped(j)) plan::rest_joint(resting_plan_, j, plan_.setpoint().position_rad[j]);
    taken = &resting_plan_;
  }
  answer(plan, plan_.accept(*taken, report_.now_ns()));
  const wire::PlanDecision& decided = report_.plan_decision;
  const bool followed = plan::reason_of(decided) == wire::PlanReject::none;
  report_.flags |= followed ? flag::kPlanNew : flag::kPlanRefused;
  if (!followed)
    report_.event(EventKind::plan_refused, decided.reject, plan.plan_id, decided.value, decided.text.data());
}

// Every plan gets an answer by its id.
void ControlStep::answer(const wire::Plan& plan, const wire::PlanDecision& decided) LITHE_RT {
  report_.plan_decided = true;
  report_.plan_decision = decided;
  report_.plan_decision.plan_id = plan.plan_id;
  report_.plan_decision.t_ns = report_.now_ns();
  EventText words;
  name(decided, words);
  const std::string_view text = words.text();
  std::copy_n(text.begin(), std::min(text.size(), decided.text.size() - 1), report_.plan_decision.text.begin());
}

// A torn plan: the previous plan continues, or with on_torn_plan = "stop" it counts as a deadline miss. Ignored while
// no plan is followed.
void ControlStep::miss_plan() LITHE_RT {
  if (robot_.brain.on_torn_plan != robot::MissPolicy::stop || mode_.mode() != wire::Mode::active) return;
  fail(wire::Fault::plan_torn, "plan_torn: four tries brought no whole plan of the Brain");
}

// All of them or none. They are not tried, so nothing outside the robot file's ranges reaches a law.
void ControlStep::take_inputs(const wire::Inputs& inputs) LITHE_RT {
  const std::size_t count = robot_.inputs.size();
  EventText why;
  if (inputs.count != count) {
    why.number(inputs.count, 0) << " inputs, the robot has ";
    return refuse_inputs(inputs.count, why.number(static_cast<double>(count), 0));
  }
  for (std::size_t i = 0; i < count; ++i) {
    const robot::InputConfig& input = robot_.inputs[i];
    const double value = inputs.value[i];
    if (value >= input.min && value <= input.max) continue;  // false for NaN
    (why << input.name << " = ").number(value, 3) << ", allowed ";
    why.number(input.min, 3) << " to ";
    return refuse_inputs(value, why.number(input.max, 3));
  }
  std::copy_n(inputs.value.begin(), count, in_.input.begin());
  inputs_ns_ = report_.now_ns();
  inputs_refused_ = false;
}

void ControlStep::refuse_inputs(double value, const EventText& why) LITHE_RT {
  if (!inputs_refused_) report_.event(EventKind::inputs_refused, 0, 0, value, why.text());
  inputs_refused_ = true;
}

CommandResult Laws::set_params(const wire::Command& command) LITHE_RT {
  law::Resident* law = slot_.active();
  if (law == nullptr || (command.law_id != 0 && command.law_id != law->law_id)) return CommandResult::refused_law;
  if (command.count == 0 || command.count > wire::kNparam) return CommandResult::refused_range;
  for (std::uint32_t i = 0; i < command.count; ++i) {
    const std::uint32_t index = command.index[i];
    if (index >= law->descriptor->param_count || index >= kMaxParams) return CommandResult::refused_range;
    const Param& param = law->params[index];
    if (!(param.min <= command.value[i] && command.value[i] <= param.max)) return CommandResult::refused_range;
  }
  if (!probation_.of_params()) law->trust_params();
  law->remember_params();
  for (std::uint32_t i = 0; i < command.count; ++i) law->set_param(command.index[i], command.value[i]);
  return params_set(command, command.count, "");
}

CommandResult Laws::revert_params(const wire::Command& command) LITHE_RT {
  law::Resident* law = slot_.active();
  if (law == nullptr || (command.law_id != 0 && command.law_id != law->law_id)) return CommandResult::refused_law;
  if (!probation_.of_params()) law->trust_params();
  law->revert_params();
  return params_set(command, law->descriptor->param_count, "as before the last change");
}

// New values are on probation; the previous ones are kept.
CommandResult Laws::params_set(const wire::Command& command, std::uint32_t count, std::string_view text) LITHE_RT {
  report_.params_changed = true;
  report_.event(EventKind::params_applied, slot_.active()->law_id, command.request_id, count, text);
  probation_.start_params(command.request_id, in_);
  return CommandResult::done;
}

CommandResult Laws::roll_back(const wire::Command& command) LITHE_RT {
  const std::uint32_t steps = std::max(1u, command.count);
  if (slot_.before(steps) == nullptr) return CommandResult::refused_law;
  if (command.law_id != 0 && command.law_id != slot_.active()->law_id) return CommandResult::refused_law;
  const std::uint32_t blend_ticks = slot_.active()->terms.blend_ticks;
  law::FieldBits mended = 0;
  slot_.rollback(law::Carry::named, steps, &mended);
  report_.flags |= flag::kRolledBack;
  probation_.start(*slot_.active(), in_, true);
  begin_law(blend_ticks);
  tell_not_carried(*slot_.active(), mended);
  report_.event(EventKind::law_rolled_back, slot_.active()->law_id, command.request_id, steps,
                "an earlier law runs again");
  report_.params_changed = true;
  return CommandResult::done;
}

}  // namespace lithe::step
