// SPDX-License-Identifier: Apache-2.0
// The run from the first to the last release, and the handling of commands and plans.
#include "spine/loop/spine.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "spine/loop/transport.hpp"

namespace lithe::loop {

using wire::CommandKind;
using wire::CommandResult;
using wire::EventKind;
namespace flag = wire::telemetry_flag;

namespace {

// A hybrid wait stops sleeping this long before the release: longer than the usual wake-up latency.
constexpr std::int64_t kHybridWindowNs = 100'000;

// After a reset the fault-reset command is sent this many times: some drives need it more than once.
constexpr std::uint32_t kTurnsToClear = 200;

// Arming accepts a sample this many ticks old.
constexpr std::uint32_t kStaleTicksToArm = 3;

// How often the law's State is published: as often as a Brain publishes plans.
constexpr double kStateHz = 100.0;

// Every drive gets at least one command in this many ticks.
std::uint32_t slowest_of(const robot::RobotConfig& robot) {
  std::uint32_t divider = 1;
  for (const robot::DeviceConfig& device : robot.devices) divider = std::max(divider, device.rate_divider);
  return divider;
}

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

Spine::Spine(const Wiring& wiring)
    : robot_(wiring.robot),
      slot_(wiring.slot),
      sandbox_(wiring.sandbox),
      cell_(wiring.cell),
      constants_(wiring.constants),
      handover_(wiring.handover),
      inline_actuators_(wiring.inline_actuators),
      clock_(wiring.clock),
      grid_(std::llround(1e9 / wiring.robot.rate_hz), wiring.robot.spine.phase_ns),
      inbox_(wiring.spine, wiring.control, wiring.brain),
      out_(wiring.spine, static_cast<std::uint32_t>(wiring.robot.joints.size())),
      joints_(static_cast<std::uint32_t>(wiring.robot.joints.size())),
      period_ns_(grid_.period_ns()),
      slowest_(slowest_of(wiring.robot)),
      state_ticks_(static_cast<std::uint64_t>(std::max(1.0, std::round(wiring.robot.rate_hz / kStateHz)))),
      simulated_(std::ranges::none_of(wiring.robot.buses, robot::is_real)),
      budget_ns_(std::llround(static_cast<double>(grid_.period_ns()) * wiring.robot.swap.budget_share)),
      sample_(&wiring.handover.latest_sample()) {
  plan_.configure(robot_);
  guard_.configure(robot_);
  probation_.configure(robot_);
  in_.joints = joints_;
  in_.dt_s = static_cast<double>(period_ns_) * 1e-9;
  hal::ActuatorCommand& first = handover_.next_command();
  first.joints = joints_;
  first.act(hal::DriveAction::off);
  if (cell_ == nullptr) return;
  for (const auto& [block, bytes] : {std::pair<void*, std::size_t>{&guard_, sizeof guard_}, {&mode_, sizeof mode_}}) {
    if (const Result<> guarded = cell_->guard(block, bytes); !guarded)
      std::fprintf(stderr, "lithe-spine: a law can reach the guard's limits: %s\n", guarded.message().c_str());
  }
}

bool Spine::run(const std::atomic<bool>& stop) noexcept {
  grid_.start(clock_.now_ns());
  std::uint32_t skipped = 0;
  while (!stop.load(std::memory_order_relaxed)) {
    const std::int64_t woke_ns =
        wait_for_release(robot_.spine.release, clock_.raw(), grid_.release_ns(), kHybridWindowNs);
    tick(grid_.release_ns(), woke_ns, skipped);
    serve_inline();
    clock_.follow();
    skipped = grid_.advance(clock_.now_ns());
  }
  const bool all_off_sent = stop_drives();
  // A supervisor that adopted this process learns of its end only through this.
  out_.event(EventKind::disarmed, clock_.now_ns(), all_off_sent ? 1 : 2, 0, 0,
             all_off_sent ? "ended: every drive got the off command" : "ended: not every drive got the off command");
  return all_off_sent;
}

// Sends "off" to every drive twice, because the Transport may still be busy with the last command at the first one.
// True when all of it was sent.
bool Spine::stop_drives() noexcept {
  const std::uint32_t rounds = 2 * slowest_;
  const std::int64_t give_up_ns = clock_.now_ns() + 200 * kNsPerMs + rounds * period_ns_;
  std::uint32_t sent = 0;
  while (sent < rounds && clock_.now_ns() < give_up_ns) {
    serve_inline();
    if (!handover_.idle()) {
      spin_pause();
      continue;
    }
    handover_.next_command().act(hal::DriveAction::off);
    handover_.next_command().joints = joints_;
    handover_.dispatch();
    ++sent;
  }
  serve_inline();
  return sent == rounds;
}

void Spine::listen(std::int64_t now_ns) LITHE_RT {
  out_.beat(now_ns);
  estop_pressed_ = inbox_.estop_pressed();
  watch_memory(now_ns);
  if (estop_pressed_ && mode_.press_estop()) out_.event(EventKind::estop, now_ns, 0, 0, 0, "the e-stop was pressed");
  if (const std::optional<CommandTicket> letter = inbox_.next_command()) obey(*letter, now_ns);
  watch_brain(now_ns);
  if (inbox_.new_plan()) {
    take_plan(now_ns);
  } else if (inbox_.plan_torn()) {
    miss_plan(now_ns);
  }
}

// The housekeeping core found damaged memory: the process cannot be trusted any more, so the robot stops.
void Spine::watch_memory(std::int64_t now_ns) LITHE_RT {
  const char* const damaged = constants_ == nullptr ? nullptr : constants_->damaged();
  if (damaged == nullptr || !memory_whole_) return;
  memory_whole_ = false;
  Words words;
  words << wire::to_string(wire::Fault::memory_damaged) << ": " << damaged;
  const law::Resident* law = slot_.active();
  out_.event(EventKind::memory_damaged, now_ns, law == nullptr ? 0 : law->law_id, 0, 0, words.text());
  if (!mode_.fail(wire::Fault::memory_damaged)) return;
  out_.event(EventKind::safe_stop, now_ns, static_cast<std::uint32_t>(wire::Fault::memory_damaged), 0, 0, words.text());
}

void Spine::obey(const CommandTicket& letter, std::int64_t now_ns) LITHE_RT {
  const wire::Command& command = inbox_.command();
  // Parameters that nobody has tried: only while there is nobody who could.
  const bool untried = letter.sender == Sender::brain && inbox_.supervised(now_ns) &&
                       static_cast<CommandKind>(command.kind) == CommandKind::set_params;
  const CommandResult result = untried ? CommandResult::refused_untried : execute(command, now_ns);
  inbox_.answer(letter, result);
  if (result == CommandResult::done) return;
  out_.event(
      EventKind::command_refused, now_ns, static_cast<std::uint32_t>(result), command.request_id,
      static_cast<double>(command.kind),
      untried ? "parameters in the Brain's mailbox: ask the supervisor, which tries them" : wire::to_string(result));
}

CommandResult Spine::execute(const wire::Command& command, std::int64_t now_ns) LITHE_RT {
  const auto kind = static_cast<CommandKind>(command.kind);
  switch (kind) {
    case CommandKind::set_params:
      return set_params(command, now_ns);
    case CommandKind::rollback:
      return roll_back(command, now_ns);
    case CommandKind::revert_params:
      return revert_params(command, now_ns);
    case CommandKind::sim_reset:
      return reset_simulation(command, now_ns);
    default:
      return change_mode(kind, command.request_id, now_ns);
  }
}

Conditions Spine::conditions() const LITHE_RT {
  // One late exchange does not refuse the command: the previous sample is only a few milliseconds old.
  bool all_fresh = sample_->sample_ns != 0 && stale_ticks_ <= kStaleTicksToArm;
  // The slew bound of the first torque starts at zero, so every drive must have got the "off" command.
  if (mode_.mode() == wire::Mode::disarmed) all_fresh = all_fresh && ticks_off_ >= slowest_;
  bool homed = true, inside = true;
  for (std::uint32_t j = 0; j < joints_; ++j) {
    if (mode_.law_runs() && guard_.stopped(j)) continue;  // other groups may continue
    constexpr std::uint32_t kReady = wire::joint_status::kFresh;
    all_fresh = all_fresh && (sample_->status[j] & (kReady | wire::joint_status::kNotReady)) == kReady;
    homed = homed && (!robot_.joints[j].must_be_homed || (sample_->status[j] & wire::joint_status::kNotHomed) == 0);
    inside = inside && guard_.recovery().inside(j, sample_->position_rad[j]);
  }
  return {slot_.active() != nullptr, all_fresh, homed, estop_pressed_, inside, memory_whole_};
}

CommandResult Spine::change_mode(CommandKind kind, std::uint64_t request_id, std::int64_t now_ns) LITHE_RT {
  const wire::Mode before = mode_.mode();
  const CommandResult result = mode_.apply(kind, conditions());
  if (result != CommandResult::done) return result;
  // Drives that are off: the slew bound starts at zero torque, and the setpoint starts at the measured position.
  if (before == wire::Mode::disarmed) guard_.reset_output();
  if (kind == CommandKind::arm && before != wire::Mode::active && before != wire::Mode::hold) mend_law(now_ns);
  if (kind == CommandKind::reset) {
    guard_.forget_faults();
    clear_ticks_left_ = kTurnsToClear * slowest_;
  }
  if (kind == CommandKind::recover) {
    guard_.forget_faults();
    guard_.start_recovery();
  }
  if (mode_.mode() == wire::Mode::hold) plan_.stop(now_ns);
  out_.event(event_of(kind), now_ns, 0, request_id, 0, "");
  return result;
}

// Puts simulated joints back to their start, as a person could with drives that are off.
CommandResult Spine::reset_simulation(const wire::Command& command, std::int64_t now_ns) LITHE_RT {
  if (!simulated_) return CommandResult::refused_not_simulated;
  if (mode_.mode() != wire::Mode::disarmed) return CommandResult::refused_mode;
  reset_simulation_ = true;
  out_.event(EventKind::sim_reset, now_ns, 0, command.request_id, 0, "");
  return CommandResult::done;
}

// Sets all values in this tick, or none.
CommandResult Spine::set_params(const wire::Command& command, std::int64_t now_ns) LITHE_RT {
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
  out_.params(*law);
  out_.event(EventKind::params_applied, now_ns, law->law_id, command.request_id, command.count, "");
  watch_params(command.request_id);
  return CommandResult::done;
}

// New values are on probation; the previous ones are kept.
void Spine::watch_params(std::uint64_t request_id) LITHE_RT {
  // While the law itself is unconfirmed, law and values are judged together.
  if (probation_.of_law()) return;
  params_request_id_ = request_id;
  probation_.start_params();
}

// The values before the last change; when called again, that change again.
CommandResult Spine::revert_params(const wire::Command& command, std::int64_t now_ns) LITHE_RT {
  law::Resident* law = slot_.active();
  if (law == nullptr || (command.law_id != 0 && command.law_id != law->law_id)) return CommandResult::refused_law;
  if (!probation_.of_params()) law->trust_params();
  law->revert_params();
  out_.params(*law);
  out_.event(EventKind::params_applied, now_ns, law->law_id, command.request_id, law->descriptor->param_count,
             "as before the last change");
  watch_params(command.request_id);
  return CommandResult::done;
}

// `count` laws back; 0 means 1.
CommandResult Spine::roll_back(const wire::Command& command, std::int64_t now_ns) LITHE_RT {
  const std::uint32_t steps = std::max(1u, command.count);
  if (slot_.before(steps) == nullptr) return CommandResult::refused_law;
  const std::uint32_t blend_ticks = slot_.active()->terms.blend_ticks;
  law::FieldBits mended = 0;
  slot_.rollback(law::Carry::named, steps, &mended);
  flags_ |= flag::kRolledBack;
  probation_.end();
  greet_law(blend_ticks);
  out_.event(EventKind::law_rolled_back, now_ns, slot_.active()->law_id, command.request_id, steps,
             "an earlier law runs again");
  tell_not_carried(*slot_.active(), mended, now_ns);
  out_.params(*slot_.active());
  return CommandResult::done;
}

void Spine::watch_brain(std::int64_t now_ns) LITHE_RT {
  const std::int64_t age_ns = inbox_.brain_age_ns(now_ns);
  out_.record().brain_age_ns = age_ns;
  const bool stale = age_ns < 0 || static_cast<double>(age_ns) > robot_.brain.stale_after_s * 1e9;
  if (stale == brain_stale_) return;
  brain_stale_ = stale;
  // The rest of a stale Brain's plan is dropped. With on_stale = "safe_stop" the guard stops the robot instead.
  const bool stops = stale && mode_.mode() == wire::Mode::active && robot_.brain.on_stale == robot::StaleAction::hold;
  if (stops) plan_.stop(now_ns);
  out_.event(stale ? EventKind::brain_stale : EventKind::brain_fresh, now_ns, 0, 0, static_cast<double>(age_ns) * 1e-9,
             !stale  ? "the Brain is back"
             : stops ? "no sign of life: the setpoint slows down and holds"
                     : "no sign of life");
}

void Spine::take_plan(std::int64_t now_ns) LITHE_RT {
  if (mode_.mode() != wire::Mode::active) return;  // a plan from before arming is dropped
  for (std::uint32_t j = 0; j < joints_; ++j) {
    if (guard_.stopped(j)) plan::rest_joint(inbox_.plan(), j, planned_rad_[j]);
  }
  const wire::PlanReject reject = plan_.accept(inbox_.plan(), now_ns);
  flags_ |= reject == wire::PlanReject::none ? flag::kPlanNew : flag::kPlanRefused;
  if (reject == wire::PlanReject::none) return;
  out_.event(EventKind::plan_refused, now_ns, static_cast<std::uint32_t>(reject), inbox_.plan().plan_id, 0,
             wire::to_string(reject));
}

// A torn plan: the previous plan continues, or with on_torn_plan = "stop" it counts as a deadline miss. Ignored while
// no plan is followed.
void Spine::miss_plan(std::int64_t now_ns) LITHE_RT {
  if (robot_.brain.on_torn_plan != robot::MissPolicy::stop || mode_.mode() != wire::Mode::active) return;
  if (!mode_.fail(wire::Fault::plan_torn)) return;
  out_.event(EventKind::safe_stop, now_ns, static_cast<std::uint32_t>(wire::Fault::plan_torn), 0, 0,
             "plan_torn: four tries brought no whole plan of the Brain");
}

}  // namespace lithe::loop
