// SPDX-License-Identifier: Apache-2.0
// lithe-spine ROBOT.toml: wires the rooms, starts the threads, waits for a signal. `lithe run` starts it.
#include <fmt/format.h>
#include <pthread.h>
#include <signal.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <ctime>
#include <memory>
#include <thread>

#include "spine/core/host.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/info.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/law/slot.hpp"
#include "spine/load/dlopen_store.hpp"
#include "spine/load/loader.hpp"
#include "spine/loop/spine.hpp"
#include "spine/loop/transport.hpp"
#include "spine/robot/robot.hpp"

namespace lithe {
namespace {

constexpr int kExitRefused = 1, kExitUsage = 2, kExitFault = 3;

int refuse(int code, const std::string& message) {
  fmt::print(stderr, "lithe-spine: {}\n", message);
  return code;
}

// The three segments of a running robot, and the right to be its Spine.
struct Memory {
  ipc::Lease lease;
  ipc::Segment<ipc::SpineMemory> spine;
  ipc::Segment<ipc::ControlMemory> control;
  ipc::Segment<ipc::BrainMemory> brain;
};

Result<Memory> make_memory(const std::string& robot) {
  const std::string path = ipc::Segment<ipc::SpineMemory>::path(robot);
  Result<std::optional<ipc::Lease>> lease = ipc::Lease::try_take(path);
  if (!lease) return lease.error();
  if (!lease->has_value()) {
    const auto other = ipc::Segment<ipc::SpineMemory>::attach(robot, ipc::Access::read);
    const std::uint64_t pid = other ? (*other)->header.writer_pid : 0;
    return Error{fmt::format("robot '{}' already has a Spine (pid {}); stop it first, or give this robot another name",
                             robot, pid)};
  }
  // A crashed run's segments are replaced: whoever still maps them keeps his own copy and sees its heartbeat age.
  auto spine = ipc::Segment<ipc::SpineMemory>::create(robot);
  if (!spine) return spine.error();
  auto control = ipc::Segment<ipc::ControlMemory>::create(robot);
  if (!control) return control.error();
  auto brain = ipc::Segment<ipc::BrainMemory>::create(robot);
  if (!brain) return brain.error();
  ipc::sign_in((*spine)->header, monotonic_ns());
  return Memory{std::move(**lease), std::move(*spine), std::move(*control), std::move(*brain)};
}

void remove_memory(const std::string& robot) {
  ipc::remove_segment(ipc::Segment<ipc::SpineMemory>::path(robot));
  ipc::remove_segment(ipc::Segment<ipc::ControlMemory>::path(robot));
  ipc::remove_segment(ipc::Segment<ipc::BrainMemory>::path(robot));
}

// Everything that runs, and how it stops: the tick first (it switches the drives off), the Transport after it.
class Threads {
 public:
  Threads(const robot::RobotConfig& robot, const CpuPlan& cpus, Memory& memory, hal::Actuators& actuators)
      : robot_(robot),
        cpus_(cpus),
        memory_(memory),
        actuators_(actuators),
        loader_(slot_, store_, *memory.spine, *memory.control, static_cast<std::uint32_t>(robot.joints.size())) {
    loop::start_clock(clock_);
  }

  void start() {
    keeper_ = std::thread([this] {
      enter(cpus_.housekeeping, false);
      loop::keep_clock(clock_, stop_helpers_);
    });
    loading_ = std::thread([this] {
      enter(cpus_.housekeeping, false);
      loader_.run(stop_helpers_);
    });
    if (!cpus_.transport_inline) {
      transport_ = std::thread([this] {
        enter(cpus_.transport, true);
        const bool shared = cpus_.transport == cpus_.housekeeping || cpus_.transport == cpus_.brain;
        loop::run_transport(handover_, actuators_, clock_, shared, stop_transport_);
      });
    }
    ticking_ = std::thread([this] {
      enter(cpus_.spine, true);
      loop::Spine spine({robot_, *memory_.spine, *memory_.control, *memory_.brain, slot_, handover_, clock_,
                         cpus_.transport_inline ? &actuators_ : nullptr});
      spine.run(stop_tick_);
    });
  }

  void stop() {
    stop_tick_ = true;
    ticking_.join();
    stop_transport_ = true;
    if (transport_.joinable()) transport_.join();
    stop_helpers_ = true;
    loading_.join();
    keeper_.join();
  }

 private:
  static void enter(int cpu, bool urgent) {
    if (const Result<> pinned = pin_this_thread(cpu); !pinned)
      fmt::print(stderr, "lithe-spine: {}\n", pinned.message());
    urgent ? (void)raise_priority() : ordinary_priority();
    touch_stack();
  }

  const robot::RobotConfig& robot_;
  CpuPlan cpus_;
  Memory& memory_;
  hal::Actuators& actuators_;
  loop::ClockMemory clock_{};
  loop::Handover handover_;
  law::Slot slot_;
  load::DlopenStore store_;
  load::Loader loader_;
  std::atomic<bool> stop_tick_{false}, stop_transport_{false}, stop_helpers_{false};
  std::thread keeper_, loading_, transport_, ticking_;
};

// What the buses did otherwise than asked: only a robot with trouble has anything to say.
void tell_replies(const hal::ReplyCounters& n) {
  if (n.missed + n.late + n.duplicate + n.stray + n.malformed + n.unsound + n.refused == 0) return;
  fmt::print(stderr,
             "lithe-spine: answers of drives: {} missed, {} late, {} doubled, {} stray, {} malformed; "
             "commands: {} not finite, {} refused by a full bus\n",
             n.missed, n.late, n.duplicate, n.stray, n.malformed, n.unsound, n.refused);
}

// Waits for SIGINT or SIGTERM. The parent's death is no reason to stop: the robot goes on and is adopted.
void wait_for_signal(const sigset_t& signals) {
  int signal = 0;
  while (sigwait(&signals, &signal) != 0) {
  }
}

int run(const std::string& path) {
  Result<robot::RobotConfig> robot = robot::load_robot(path);
  if (!robot) return refuse(kExitUsage, robot.message());

  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);  // inherited by every thread: only this one takes them
  signal(SIGPIPE, SIG_IGN);

  Result<CpuPlan> cpus = choose_cpus(*robot, allowed_cpus());
  if (!cpus) return refuse(kExitUsage, robot->path + ": " + cpus.message());
  Result<Memory> memory = make_memory(robot->name);
  if (!memory) return refuse(kExitRefused, memory.message());
  Result<std::unique_ptr<hal::Actuators>> actuators = hal::open_actuators(*robot);
  if (!actuators) {
    remove_memory(robot->name);
    return refuse(kExitFault, actuators.message());
  }
  if (cpus->spine_shares) robot->spine.release = robot::Release::sleep;
  freeze_malloc();
  use_small_stacks();
  const std::string notes = describe_host(*robot, *cpus);
  write_robot_info(memory->spine->robot_info, *robot, *cpus, notes);
  if (const Result<> pinned = pin_this_thread(cpus->housekeeping); !pinned)
    fmt::print(stderr, "{}\n", pinned.message());

  auto threads = std::make_unique<Threads>(*robot, *cpus, *memory, **actuators);
  threads->start();
  fmt::print("{}\n", ready_line(*robot, *cpus, notes));
  std::fflush(stdout);
  wait_for_signal(signals);
  threads->stop();
  tell_replies((*actuators)->counters());
  remove_memory(robot->name);
  return 0;
}

}  // namespace
}  // namespace lithe

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fputs("usage: lithe-spine ROBOT.toml\n  `lithe run ROBOT.toml` starts it together with all it needs\n",
               stderr);
    return lithe::kExitUsage;
  }
  return lithe::run(argv[1]);
}
