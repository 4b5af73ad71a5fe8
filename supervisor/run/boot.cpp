// SPDX-License-Identifier: Apache-2.0
// Start-up: from the robot file to a Spine that ticks and a socket that answers.
#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>
#include <sys/file.h>
#include <sys/signalfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/time.hpp"
#include "spine/robot/cores/cpu_plan.hpp"
#include "spine/robot/robot.hpp"
#include "spine/robot/values.hpp"
#include "supervisor/bus/plan/plan.hpp"
#include "supervisor/run/supervisor.hpp"
#include "supervisor/serve/status.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;

constexpr int kCheckTimeoutMs = 10'000;
constexpr std::int64_t kReadyTimeoutNs = 30 * kNsPerS;
constexpr std::int64_t kLookNs = kNsPerS;  // between two looks at the socket's file

// Why a Spine does not run the robot of this file; empty: it does.
std::string other_robot(const robot::RobotConfig& robot, const wire::RobotInfo& info) {
  if (info.values_hash == robot::values_hash(robot.values)) return "";
  const std::string path = fmt::format("{}/{}{}", run_dir(), robot.name, kValuesEnding);
  const auto theirs = read_regular_file(path, kMaxConfigBytes);
  const bool known = theirs && robot::values_hash(*theirs) == info.values_hash;
  return fmt::format("it runs another robot than {} describes (it was started with {}):\n{}", robot.path,
                     text_of(info.config_path),
                     known ? robot::values_difference(robot.values, *theirs)
                           : fmt::format("  which values differ is not known: {} is gone\n", path));
}

// Says why the robot is not started; returns the exit code.
int refuse(const Refusal& why, int code, bool json) {
  std::cerr << why.message << "\nnext: " << why.next << '\n';
  if (json) std::cout << Json{{"ok", false}, {"error", why.to_json()}} << '\n';
  return code;
}

}  // namespace

int run_robot(const RunOptions& options) {
  set_file_defaults();
  spdlog::set_default_logger(spdlog::stderr_color_mt("lithe"));
  spdlog::set_pattern("%H:%M:%S.%e %^%l%$ %v");
  auto config = robot::load_robot(options.config_path);
  if (!config) return refuse({"bad_config", config.message(), "correct the file, or name another"}, 2, options.json);
  // First: what a killed robot's shield left narrows the cores that we may use. A robot that lives on keeps it until it
  // is raised anew, or stays without.
  if (!live_spine(config->name) || !options.shield) {
    const auto left = host::Shield::lower_left_over();
    if (!left && options.shield)
      return refuse({"no_shield", left.message(), "stop the other robot, or leave out --shield"}, 1, options.json);
    // Without root the folder of the journal may be closed: then it is not known, and mostly there is none.
    if (!left && ::access(host::kShieldJournal, F_OK) == 0)
      spdlog::warn("the shield of another robot, or one that a killed robot left: {}; sudo lithe run lowers the latter",
                   left.message());
    if (left && left->count > 0) spdlog::warn("a killed robot left its shield: {} changes undone", left->count);
    if (left && !left->born.empty()) spdlog::warn("{}", host::born_words(*left));
  }
  const MachineCores cores = machine_cores();
  if (const auto plan = robot::plan_cpus(*config, cores); plan)
    for (std::string& cost : robot::costs_of(*plan, config->spine, cores)) config->notes.push_back(std::move(cost));
  else if (!live_spine(config->name))  // a Spine that ticks has its cores already
    return refuse({"bad_config", plan.message(), "correct the file, or name another"}, 2, options.json);
  for (const std::string& note : config->notes) spdlog::warn("{}", note);
  const bus::Verdict load = bus::judge_for_run(*config);
  if (load.refuse) return refuse({"bus_overload", load.text, load.next}, 1, options.json);
  if (!load.text.empty()) spdlog::warn("{}; {}", load.text, load.next);
  return Supervisor(options, std::move(*config)).run();
}

void Supervisor::open_run_folder() {
  std::error_code failure;
  fs::create_directories(run_dir(), failure);
  run_ = must(open_own_folder(run_dir(), "LITHE_RUN_DIR"));
  if (!run_) {
    throw Halt{1, fmt::format("cannot create {}: {}; set LITHE_RUN_DIR", run_dir(),
                              failure ? failure.message() : std::strerror(errno))};
  }
}

void Supervisor::take_lease() {
  open_run_folder();
  auto lease = must(ipc::Lease::try_take(ipc::Segment<ipc::ControlMemory>::path(config_.name)));
  if (!lease) {
    throw Halt{1, fmt::format("robot '{}' already has a supervisor (pid {}); use lithe status, or stop it first",
                              config_.name, noted_supervisor(config_.name))};
  }
  lease_ = std::move(*lease);
  take_pid_file();
  owns_files_ = true;
  if (const auto pinned = set_affinity(0, our_cpus_); !pinned) spdlog::warn("{}", pinned.message());
}

// The pid file stays locked: a supervisor in a container has a /dev/shm of its own, but may have the same run folder.
void Supervisor::take_pid_file() {
  const std::string path = fmt::format("{}/{}.pid", run_dir(), config_.name);
  Fd file = must(open_regular(run_.get(), config_.name + ".pid", O_RDWR | O_CREAT));
  if (::flock(file.get(), LOCK_EX | LOCK_NB) != 0) {
    throw Halt{1,
               fmt::format("another supervisor of a robot '{}', perhaps in another container, holds {} (pid {} there); "
                           "stop it, or set LITHE_RUN_DIR to a folder of its own for each",
                           config_.name, path, noted_supervisor(config_.name))};
  }
  const int failed = ::ftruncate(file.get(), 0) != 0 ? errno : write_all(file.get(), fmt::format("{}\n", ::getpid()));
  if (failed != 0) throw Halt{1, fmt::format("cannot write {}: {}", path, reason_of(failed))};
  pid_file_ = std::move(file);
}

bool Supervisor::has_pid_file() const {
  struct stat about{};
  return ::fstat(pid_file_.get(), &about) == 0 && about.st_nlink > 0;
}

void Supervisor::write_run_file(const std::string& ending, const std::string& text) {
  const Fd file = must(open_regular(run_.get(), config_.name + ending, O_WRONLY | O_CREAT | O_TRUNC));
  if (const int failed = write_all(file.get(), text); failed != 0)
    throw Halt{1, fmt::format("cannot write {}/{}{}: {}", run_dir(), config_.name, ending, reason_of(failed))};
}

void Supervisor::catch_signals() {
  sigset_t set;
  sigemptyset(&set);
  for (const int number : {SIGINT, SIGTERM}) {
    // A shell starts background jobs with SIGINT ignored. Here SIGINT must always stop the robot.
    ::signal(number, SIG_DFL);
    sigaddset(&set, number);
  }
  struct sigaction hangup{};
  if (::sigaction(SIGHUP, nullptr, &hangup) == 0 && hangup.sa_handler != SIG_IGN) sigaddset(&set, SIGHUP);
  ::signal(SIGPIPE, SIG_IGN);
  ::sigprocmask(SIG_BLOCK, &set, nullptr);
  signals_.reset(::signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK));
}

// Reports errors of the file that the Spine would refuse, before the compile service starts.
void Supervisor::check_robot() {
  int err[2];
  if (::pipe2(err, O_CLOEXEC) != 0) throw Halt{1, fmt::format("cannot make a pipe: {}", std::strerror(errno))};
  const Fd ours(err[0]);
  Fd theirs(err[1]);
  Launch launch;
  launch.argv = {program_dir() + "/lithe-spine-sim", "--check", fs::absolute(options_.config_path).string()};
  launch.stderr_fd = theirs.get();
  launch.dies_with_parent = true;
  launch.cpus = all_cpus_;
  Process process = must(Process::start(launch));
  theirs.reset();
  std::string said;
  char chunk[4096];
  pollfd wait{ours.get(), POLLIN, 0};
  for (ssize_t got = 1; got > 0 && ::poll(&wait, 1, kCheckTimeoutMs) > 0;) {
    got = ::read(ours.get(), chunk, sizeof(chunk));
    said.append(chunk, static_cast<std::size_t>(std::max<ssize_t>(got, 0)));
  }
  if (!process.wait(kCheckTimeoutMs) || process.exit_code().value_or(1) != 0) {
    process.signal(SIGKILL);  // it hangs
    constexpr std::string_view kWho = "lithe-spine: ";
    said.erase(0, said.starts_with(kWho) ? kWho.size() : 0);
    said.erase(said.find_last_not_of('\n') + 1);
    throw Halt{
        process.exit_code() == 2 ? 2 : 1,
        said.empty() ? fmt::format("the check of {} failed: {}", options_.config_path, process.verdict()) : said};
  }
}

void Supervisor::start_lawd() {
  arena_ = open_arena(config_);
  lawd_.give(arena_.get());
  must(lawd_.start(monotonic_ns()));
}

// Started before the Spine, like lawd: it forks.
void Supervisor::start_trial() {
  if (!options_.gates) {
    spdlog::warn(
        "THE GATES ARE OPEN: laws are neither admitted nor run dry nor tried; only the Spine's own containment is "
        "left. Never with a robot that can hurt a person");
    return lawd_.open_gates();
  }
  trial_.give(arena_.get());
  must(trial_.start(monotonic_ns()));
}

void Supervisor::start_spine() {
  int out[2];
  const Fd log = must(open_regular(run_.get(), config_.name + kLogEnding, O_CREAT | O_TRUNC | O_WRONLY | O_APPEND));
  if (::pipe2(out, O_CLOEXEC) != 0) throw Halt{1, fmt::format("cannot make a pipe: {}", std::strerror(errno))};
  write_run_file(kValuesEnding, config_.values);
  spine_out_.reset(out[0]);
  ::fcntl(out[0], F_SETFL, O_NONBLOCK);
  const Fd theirs(out[1]);
  Launch launch;
  const bool real = std::ranges::all_of(config_.buses, robot::is_real);  // the other has simulated devices, too
  launch.argv = {program_dir() + (real ? "/lithe-spine" : "/lithe-spine-sim"),
                 fs::absolute(options_.config_path).string()};
  launch.stdout_fd = theirs.get();
  launch.stderr_fd = log.get();  // a file and not a pipe: the Spine may outlive us
  launch.extra_fd = arena_.get();
  launch.own_session = true;
  launch.cpus = all_cpus_;
  spine_.emplace(must(Process::start(launch)));
  const auto ready = [this] { return spine_said_.find("\"ready\"") != std::string::npos; };
  if (!turn_until(ready, kReadyTimeoutNs))
    throw Halt{3, fmt::format("the Spine was not ready within 30 s; see {}", log_path_)};
  spine_out_.reset();
}

// A Spine that we cannot watch or command is left running: it may be moving a robot.
void Supervisor::adopt_spine(pid_t pid) {
  const auto refuse = [this, pid](const std::string& why) {
    const std::string who = pid > 0 ? fmt::format("pid {}", pid) : "pid unknown, perhaps in another container";
    const std::string how = pid > 0 ? fmt::format("kill {}", pid) : "end its process";
    return Halt{1, fmt::format("robot '{}' already has a Spine ({}), and it cannot be adopted: {}; it was left as it "
                               "is. End it in order ({}: its drives are switched off), then start again",
                               config_.name, who, why, how)};
  };
  auto process = pid > 0 ? Process::adopt(pid) : Result<Process>(Error{"its memory does not tell its process"});
  if (!process) throw refuse(process.message());
  adopted_ = true;
  spine_.emplace(std::move(*process));
  auto link = SpineLink::attach(config_.name);
  if (!link) throw refuse(link.message());
  if (const std::string other = other_robot(config_, link->info()); !other.empty())
    throw refuse(other + "start with the file it runs, to adopt it");
  serve_spine(std::move(*link));
  spdlog::info("robot '{}' is already ticking (Spine pid {}): adopted as it is", config_.name, pid);
}

void Supervisor::attach() {
  SpineLink link = must(SpineLink::attach(config_.name));
  if (link.info().values_hash != robot::values_hash(config_.values))
    throw Halt{1, fmt::format("{} was changed during the start; start again", options_.config_path)};
  serve_spine(std::move(link));
}

void Supervisor::serve_spine(SpineLink link) {
  link_.emplace(std::move(link));
  // Request ids start at the monotonic time [us]: two supervisors of one boot never use the same id.
  const auto first_id = static_cast<std::uint64_t>(monotonic_ns() / kNsPerUs);
  commands_.emplace(*link_, first_id, [this] { return DriveFacts{&config_, drives_told_, told_by_drive}; });
  swaps_.emplace(Swaps::Helpers{*link_, lawd_, options_.gates ? &trial_ : nullptr, *commands_, events_},
                 CertificateFiles(records_of(config_.name)), first_id, config_);
  incidents_.emplace(incidents_of(config_.name), events_);
  const wire::RobotInfo& info = link_->info();
  const int transport = info.transport_inline != 0 ? -1 : static_cast<int>(info.cpu_transport);
  const std::vector<int> ours = cores_beside(all_cpus_, static_cast<int>(info.cpu_spine), transport);
  for (const pid_t pid : {::getpid(), lawd_.pid(), trial_.pid()})
    if (const auto pinned = pid != 0 ? set_affinity(pid, ours) : done(); !pinned) spdlog::warn("{}", pinned.message());
}

void Supervisor::open_socket() {
  server_.emplace(must(Server::listen(
      control_socket_path(config_.name),
      [this](const ReplyTo& to, const std::string& verb, const Json& args) { verbs_->handle(to, verb, args); })));
  verbs_.emplace(
      Parts{config_, *link_, lawd_, trial_, *commands_, *swaps_, *incidents_, events_, throttle_, adopted_,
            shield_told_, drives_told_},
      [this](const ReplyTo& to, const Answer& answer) {
        if (server_) server_->reply(to, answer);
      },
      [this] { stop_asked_ = true; });
}

// A cleaner of old files, or a person, may have removed the socket, or the whole folder: no verb would reach the robot.
void Supervisor::keep_reachable(std::int64_t now_ns) {
  if (!server_ || now_ns - reachable_ns_ < kLookNs) return;
  reachable_ns_ = now_ns;
  if (server_->is_there() && has_pid_file()) return;
  const std::string path = control_socket_path(config_.name);
  const auto again = [&] {
    open_run_folder();
    if (!has_pid_file()) take_pid_file();
    must(server_->listen_again());
    spdlog::warn("{}, or the pid file beside it, was removed: made again", path);
  };
  if (code_of(again) == 0) return;
  spdlog::error("no new client reaches this robot: {} cannot be made again; tried every 30 s", path);
  reachable_ns_ = now_ns + 29 * kNsPerS;
}

void Supervisor::announce() const {
  const wire::Telemetry now = link_->now();
  const auto law = link_->law(now.law_id);
  const std::string law_name = law ? text_of(law->name) : "none";
  const std::string mode(to_string(static_cast<wire::Mode>(now.mode)));
  if (options_.json) {
    std::cout << Json{{"event", "running"},
                      {"robot", config_.name},
                      {"law", law_name},
                      {"mode", mode},
                      {"rate_hz", link_->info().rate_hz},
                      {"adopted", adopted_},
                      {"gates", options_.gates},
                      {"shield", shield_told_},
                      {"supervisor_pid", ::getpid()},
                      {"spine_pid", spine_->pid()},
                      {"socket", control_socket_path(config_.name)}}
              << std::endl;
  } else {
    std::cout << fmt::format("robot '{}' runs: law {}, {:g} Hz, {}. Ctrl-C stops it.", config_.name, law_name,
                             link_->info().rate_hz, mode)
              << std::endl;
  }
}

}  // namespace lithe::control
