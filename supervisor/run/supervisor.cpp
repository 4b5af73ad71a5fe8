// SPDX-License-Identifier: Apache-2.0
// The supervisor's event loop.
#include "supervisor/run/supervisor.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <sys/signalfd.h>

#include <algorithm>
#include <exception>
#include <filesystem>
#include <memory>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/text.hpp"
#include "spine/core/time.hpp"
#include "spine/robot/cores/cpu_plan.hpp"

namespace lithe::control {
namespace {

constexpr int kIdleTurnMs = 20;
constexpr std::int64_t kThrottleNs = kNsPerS;  // between two readings

// The Spine's own plan. One that cannot be was refused before, but for a Spine that ticks already.
robot::CpuPlan plan_of(const robot::RobotConfig& robot) {
  const MachineCores cores = machine_cores();
  const Result<robot::CpuPlan> plan = robot::plan_cpus(robot, cores);
  return plan ? *plan : robot::fold_cpus(cores, robot.spine);
}

std::vector<int> beside_the_spine(const std::vector<int>& allowed, const robot::CpuPlan& plan) {
  return cores_beside(allowed, plan.spine, plan.transport);
}

}  // namespace

Supervisor::Supervisor(RunOptions options, robot::RobotConfig config)
    : options_(std::move(options)),
      config_(std::move(config)),
      all_cpus_(allowed_cpus()),
      shield_cpus_(robot::own_cores(plan_of(config_))),
      our_cpus_(beside_the_spine(all_cpus_, plan_of(config_))),
      born_ns_(monotonic_ns()),
      lawd_(program_dir() + "/lawd", our_cpus_, config_.joints.size(), config_.swap.compile_s),
      trial_(program_dir() + "/lithe-trial", std::filesystem::absolute(options_.config_path).string(), our_cpus_),
      log_path_(fmt::format("{}/{}{}", run_dir(), config_.name, kLogEnding)) {}

Supervisor::~Supervisor() = default;

int Supervisor::run() {
  const int lived = code_of([this] { live(); });
  const int ended = code_of([this] { stop(); });  // also after an error: the drives must be switched off
  lower_shield();
  return std::max(lived, ended);
}

int Supervisor::code_of(const std::function<void()>& part) {
  try {
    part();
    return 0;
  } catch (const Halt& halt) {
    if (!halt.message.empty()) spdlog::error("{}", halt.message);
    return halt.code;
  } catch (const std::exception& wrong) {
    spdlog::error("the supervisor itself went wrong: {}", wrong.what());
    return 3;
  }
}

void Supervisor::live() {
  take_lease();
  catch_signals();
  if (!live_spine(config_.name)) check_robot();
  raise_shield();
  start_lawd();
  start_trial();
  if (const auto pid = live_spine(config_.name)) {
    adopt_spine(*pid);
    swap_adopted_law();
  } else {
    compile_first_law();
    try_safe_law();
    start_spine();
    attach();
    swap_first_law();
    arm();
  }
  open_socket();
  announce();
  while (!stop_asked_) turn(kIdleTurnMs);
}

void Supervisor::turn(int timeout_ms) {
  std::vector<pollfd> fds;
  fds.push_back({signals_.get(), POLLIN, 0});
  fds.push_back({lawd_.poll_fd(), POLLIN, 0});  // poll() passes over -1
  fds.push_back({trial_.poll_fd(), POLLIN, 0});
  fds.push_back({spine_ ? spine_->poll_fd() : -1, POLLIN, 0});
  fds.push_back({spine_out_.get(), POLLIN, 0});
  if (server_) server_->add_poll_fds(fds);
  const bool hurry = (commands_ && commands_->waiting()) || (swaps_ && swaps_->waiting());
  ::poll(fds.data(), fds.size(), hurry ? 1 : timeout_ms);
  const std::int64_t now_ns = monotonic_ns();
  read_signals();
  lawd_.serve(now_ns);
  if (options_.gates) trial_.serve(now_ns);
  read_spine();
  if (link_) {
    link_->heartbeat(now_ns);
    read_events();
    commands_->serve(now_ns);
    if (swaps_) swaps_->serve(now_ns);
    if (incidents_) incidents_->serve(*link_, now_ns);
  }
  if (server_) server_->serve();
  keep_reachable(now_ns);
  watch_throttling(now_ns);
  keep_shield_up(now_ns);
  if (spine_ && !stopping_ && spine_->ended()) spine_died();
}

bool Supervisor::turn_until(const std::function<bool()>& done, std::int64_t timeout_ns) {
  const std::int64_t deadline_ns = monotonic_ns() + timeout_ns;
  while (!done()) {
    if (monotonic_ns() > deadline_ns) return false;
    turn(5);
    if (stop_asked_ && !stopping_) throw Halt{0, ""};
  }
  return true;
}

std::optional<Answer> Supervisor::answer_to(const Ask& ask, std::int64_t timeout_ns) {
  const auto answer = std::make_shared<std::optional<Answer>>();  // it may come when nobody waits for it any more
  ask([answer](const Answer& got) { *answer = got; });
  turn_until([&answer] { return answer->has_value(); }, timeout_ns);
  return *answer;
}

void Supervisor::read_signals() {
  signalfd_siginfo info;
  while (::read(signals_.get(), &info, sizeof(info)) == sizeof(info)) {
    if (!stop_asked_) spdlog::info("stopping: {}", ::strsignal(static_cast<int>(info.ssi_signo)));
    stop_asked_ = true;
  }
}

void Supervisor::read_spine() {
  forward_spine_log();
  if (!spine_out_) return;
  char chunk[4096];
  const ssize_t got = ::read(spine_out_.get(), chunk, sizeof(chunk));
  if (got > 0)
    spine_said_.append(chunk, static_cast<std::size_t>(got));
  else if (got == 0)
    spine_out_.reset();
}

void Supervisor::forward_spine_log() {
  if (!spine_) return;
  const auto file = open_regular(run_.get(), config_.name + kLogEnding, O_RDONLY);
  if (!file) return;
  char chunk[4096];
  ssize_t got = 0;
  while ((got = ::pread(file->get(), chunk, sizeof(chunk), log_read_)) > 0) {
    log_read_ += got;
    log_lines_.feed({chunk, static_cast<std::size_t>(got)});
  }
  while (const auto said = log_lines_.next()) {
    const std::string line = printable(*said);
    spdlog::info("spine: {}", line);
    const auto told = drives_told_in(line);
    if (!told || *told == drives_told_) continue;
    drives_told_ = *told;
    events_.add(
        {{"t_ns", monotonic_ns()}, {"tick", 0}, {"kind", "drives"}, {"text", told->empty() ? "all well" : *told}});
  }
}

void Supervisor::note(const Json& event) {
  events_.add(event);
  // Skip the events that an adopted Spine wrote before this supervisor started.
  if (event["t_ns"].get<std::int64_t>() >= born_ns_) spdlog::info("{}", event_line(event));
}

void Supervisor::read_events() {
  const std::int64_t now_ns = monotonic_ns();
  for (const wire::Event& event : link_->drain_events()) {
    if (swaps_)  // absent when start-up failed before they were made; the drives are switched off in any case
      swaps_->on_event(event, now_ns);
    const Json told = event_json(event, *link_);
    if (noise_.passes(event, now_ns)) note(told);
    if (incidents_) incidents_->on_event(*link_, event, event_line(told));
  }
  for (const NoiseFilter::Summary& more : noise_.summaries(now_ns)) {
    Json json = event_json(more.last, *link_);
    json["count"] = more.count;
    json["text"] = fmt::format("{} more within a second", more.count);
    note(json);
  }
  events_.set_lost(link_->lost_events());
}

void Supervisor::watch_throttling(std::int64_t now_ns) {
  if (now_ns - throttle_read_ns_ < kThrottleNs) return;
  throttle_read_ns_ = now_ns;
  const std::string changed = throttle_.look(host::read_throttle(host::HostFiles()));
  if (!changed.empty()) events_.note(0, throttle_.active() ? "throttled" : "not_throttled", changed);
}

void Supervisor::spine_died() {
  forward_spine_log();
  std::string why = fmt::format("the Spine (pid {}) is gone: {}", spine_->pid(), spine_->verdict());
  wire::Telemetry last{};
  if (link_) {
    read_events();
    if (incidents_) incidents_->finish(*link_);
    if (link_->latest(last)) {
      why +=
          fmt::format("; last tick {} in mode {}, fault {}", last.tick, to_string(static_cast<wire::Mode>(last.mode)),
                      to_string(static_cast<wire::Fault>(last.fault)));
    }
    const Refusal reason{"robot_fault", why, "the drives' own watchdogs stop the robot; start again: lithe run"};
    if (swaps_) swaps_->refuse_all(reason, monotonic_ns());
    commands_->refuse_all(reason);
  }
  why += fmt::format("; the drives' own watchdogs stop the robot; its last words are in {}", log_path_);
  // Before "ready" it commanded no drive. Its exit code tells a refusal (1) from a wrong file (2).
  const int said = link_ ? 0 : spine_->exit_code().value_or(0);
  throw Halt{said == 1 || said == 2 ? said : 3, why};
}

}  // namespace lithe::control
