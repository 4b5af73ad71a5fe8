// SPDX-License-Identifier: Apache-2.0
// `lithe tune shield -- COMMAND`, and the cores that `lithe tune` means.
#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <optional>

#include "host/read/machine.hpp"
#include "host/tune/shield/shield.hpp"
#include "spine/core/host/child.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/fd.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/host/shield_group.hpp"
#include "spine/robot/cores/cpu_plan.hpp"
#include "spine/robot/robot.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/host/target.hpp"

namespace lithe::cli {
namespace {

constexpr int kNotStarted = 127, kSignalled = 128;

std::optional<robot::RobotConfig> robot_of(const TuneWords& words) {
  if (words.robot.empty()) return std::nullopt;
  return value_of(robot::load_robot(words.robot), "bad_config", "correct the file, or name another");
}

// As the Spine plans it.
robot::CpuPlan plan_of(const std::vector<int>& all, bool image, const std::optional<robot::RobotConfig>& robot) {
  MachineCores machine =
      image ? MachineCores{.online = all, .affinity = all, .granted = all, .isolated = {}} : machine_cores();
  machine.affinity = machine.granted;  // of this shell it may be narrowed: the plan is one for the machine
  if (!robot) return robot::fold_cpus(machine);
  return value_of(robot::plan_cpus(*robot, machine), "bad_config", "correct the file, or name another");
}

void stop_and_wait(pid_t child, const sigset_t& awaited, host::Shield& shield, int& status) {
  constexpr timespec kBetweenLooks = {10, 0};
  while (::waitpid(child, &status, WNOHANG) == 0) {
    siginfo_t info{};
    const int number = ::sigtimedwait(&awaited, &info, &kBetweenLooks);
    const auto kept = shield.keep_up();
    if (!kept || !kept->empty()) std::cerr << "shield: " << (kept ? *kept : kept.message()) << std::endl;
    // A terminal sends Ctrl-C to the command as well: only what was sent to us alone is passed on.
    if (number > 0 && number != SIGCHLD && info.si_code <= 0) ::kill(child, number);
  }
}

// All threads of the command: it has the robot's cores then, and no others.
bool join_partition() {
  const Fd group(::open((std::string(kShieldGroup) + "/cgroup.procs").c_str(), O_WRONLY | O_CLOEXEC));
  return group && ::write(group.get(), "0", 1) == 1;
}

// Runs the command; its exit code as a shell tells it.
int run_command(const std::vector<std::string>& words, const sigset_t& awaited, const sigset_t& before,
                host::Shield& shield) {
  const bool inside = shield.has_partition();
  const pid_t parent = ::getpid();
  const pid_t child = ::fork();
  if (child == 0) {
    ::prctl(PR_SET_PDEATHSIG, SIGTERM);  // it must not run on without its shield
    if (::getppid() != parent) ::_exit(kNotStarted);
    ::sigprocmask(SIG_SETMASK, &before, nullptr);
    if (inside && !join_partition())
      std::cerr << "lithe tune shield: the command is not in the partition: " << std::strerror(errno) << std::endl;
    const int why = exec_program(words);
    std::cerr << "lithe tune shield: cannot start " << words[0] << ": " << std::strerror(why) << std::endl;
    ::_exit(kNotStarted);
  }
  if (child < 0) throw control::Refusal{"no_program", fmt::format("cannot start {}", words[0]), std::strerror(errno)};
  int status = 0;
  stop_and_wait(child, awaited, shield, status);
  return WIFEXITED(status) ? WEXITSTATUS(status) : kSignalled + WTERMSIG(status);
}

// For the unit of systemd: this program; of an image, the one that is installed there.
std::string program_of(const host::Target& target) {
  if (!target.image) return program_dir() + "/lithe";
  std::error_code failed;
  for (const char* path : {"/usr/local/bin/lithe", "/usr/bin/lithe"})
    if (std::filesystem::exists(target.root + path, failed)) return path;
  return "";
}

}  // namespace

host::Target place_of(const TuneWords& words) {
  host::Target target{.image = !words.root.empty()};
  if (target.image) {
    std::error_code failed;
    target.root = std::filesystem::canonical(words.root, failed).string();
    if (failed || !std::filesystem::is_directory(target.root))
      throw control::Refusal{"usage", fmt::format("--root {}: is no folder", words.root), "mount the image there"};
    if (target.root == "/") throw control::Refusal{"usage", "--root / is this machine", "leave out --root"};
  }
  target.all_cores = host::online_cores(host::HostFiles(target.root, target.image));
  if (target.all_cores.empty()) target.all_cores = {0, 1, 2, 3};
  return target;
}

host::Target target_of(const TuneWords& words) {
  host::Target target = place_of(words);
  const std::optional<robot::RobotConfig> robot = robot_of(words);
  if (words.cores.empty()) {
    const robot::CpuPlan plan = plan_of(target.all_cores, target.image, robot);
    target.cores = robot::own_cores(plan);
    target.spine = plan.spine;
  } else {
    target.cores = parse_cpu_list(words.cores);
    // An image does not say how many cores its machine has: at least those.
    while (target.image && !target.cores.empty() && target.all_cores.back() < target.cores.back())
      target.all_cores.push_back(target.all_cores.back() + 1);
    if (robot) target.spine = robot->spine.cpu_spine;
  }
  target.robot = robot;
  target.partition = words.partition;
  target.files = !words.no_files;
  target.program = program_of(target);
  const bool known = std::ranges::includes(target.all_cores, target.cores);
  if (target.all_cores.size() < 2)
    throw control::Refusal{"usage", "this machine has one core: none can be kept free for a robot",
                           "nothing to tune: `lithe run` works there, and shares the core"};
  if (target.cores.empty() || !known || target.cores.size() == target.all_cores.size()) {
    throw control::Refusal{"usage",
                           words.cores.empty() ? "this machine has no core to spare for a robot"
                                               : fmt::format("--cores {}: the cores are {}, and one must be left",
                                                             words.cores, cpu_list(target.all_cores)),
                           "name some of them: lithe tune plan --cores 1"};
  }
  return target;
}

void tell_left_over(const host::Lowered& left) {
  if (left.count > 0) std::cerr << "a killed robot left its shield: " << left.count << " changes undone" << std::endl;
  if (!left.born.empty()) std::cerr << host::born_words(left) << std::endl;
}

int tune_shield(const Context&, const TuneWords& words) {
  // Before anything is changed: from here on the shield is lowered whichever signal comes.
  sigset_t awaited, before;
  ::sigemptyset(&awaited);
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGPIPE, SIGCHLD}) ::sigaddset(&awaited, number);
  ::sigprocmask(SIG_BLOCK, &awaited, &before);
  // What a killed shield left narrows the cores that we and the command inherit.
  tell_left_over(value_of(host::Shield::lower_left_over(), "no_shield",
                          ::geteuid() == 0 ? "wait for its end, or stop it" : "sudo lithe tune shield -- COMMAND"));
  const host::Target target = target_of(words);
  // The kernel moves no task away from a core that it no longer balances: this process and the command must leave it
  // first.
  (void)set_allowed_cpus(0, cores_without(target.all_cores, target.cores));  // refused: the command starts there
  auto raised = host::Shield::raise({.cores = target.cores, .leave = {::getpid()}, .partition = words.partition});
  (void)set_allowed_cpus(0, target.all_cores);
  host::Shield shield = value_of(std::move(raised), "no_shield", "sudo lithe tune shield -- COMMAND");
  std::cerr << "shield: " << host::shield_words(shield.facts()) << std::endl;
  for (const std::string& note : shield.facts().notes) std::cerr << "shield: " << note << std::endl;
  const int code = run_command(words.command, awaited, before, shield);
  const auto lowered = shield.lower();
  const std::string last = lowered ? host::born_words(*lowered) : lowered.message();
  if (!last.empty()) std::cerr << "shield: " << last << std::endl;
  return code;
}

}  // namespace lithe::cli
