// SPDX-License-Identifier: Apache-2.0
#include "spine/process.hpp"

#include <fmt/format.h>
#include <pthread.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <ctime>
#include <future>
#include <memory>
#include <span>
#include <string_view>
#include <thread>

#include "spine/code_arena.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/contain/memory/constants.hpp"
#include "spine/contain/memory/protected_memory.hpp"
#include "spine/contain/watchdog.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/time.hpp"
#include "spine/frames.hpp"
#include "spine/hal/robot_hardware.hpp"
#include "spine/info.hpp"
#include "spine/law/slot.hpp"
#include "spine/load/law_store.hpp"
#include "spine/load/loader.hpp"
#include "spine/loop/spine.hpp"
#include "spine/loop/transport.hpp"
#include "spine/memory.hpp"
#include "spine/robot/robot.hpp"

namespace lithe {
namespace {

constexpr std::size_t kProtectedBytes = std::size_t{1} << 20;
constexpr int kExitRefused = 1, kExitUsage = 2, kExitFault = 3;

int refuse(int code, const std::string& message) {
  fmt::print(stderr, "lithe-spine: {}\n", message);
  return code;
}

// Memory around laws: the two sandboxes, which a law may write, and the protected memory (Spine, Slot, Residents),
// which it may not.
struct Containment {
  std::unique_ptr<contain::ProtectedMemory> protected_memory;
  law::SandboxMemory ticking, loading;
};

Result<Containment> contain_laws() {
  if (const Result<> handlers = contain::install_handlers(); !handlers) return handlers.error();
  Result<std::unique_ptr<contain::ProtectedMemory>> protected_memory = contain::ProtectedMemory::make(kProtectedBytes);
  if (!protected_memory) return protected_memory.error();
  Result<law::SandboxMemory> ticking = law::SandboxMemory::make();
  if (!ticking) return ticking.error();
  Result<law::SandboxMemory> loading = law::SandboxMemory::make();
  if (!loading) return loading.error();
  return Containment{std::move(*protected_memory), std::move(*ticking), std::move(*loading)};
}

// The arena's store, in the protected memory; nullptr without an arena.
load::LawStore* keep_store(const Result<std::unique_ptr<load::ArenaStore>>& arena,
                           contain::ProtectedMemory& protected_memory) {
  if (!arena || *arena == nullptr) return nullptr;
  (void)(*arena)->arena().lock();  // locked at least in part; the notes say what was not
  return protected_memory.create<load::ArenaStore>((*arena)->take_arena());
}

// Registers the memory to be checked: constant data that is neither in the protected memory nor on read-only pages.
Result<> watch_constants(contain::Constants& constants, const robot::RobotConfig& robot, const Memory& memory) {
  const ipc::SpineMemory& shared = *memory.spine;
  const struct {
    const char* name;
    const void* from;
    std::size_t bytes;
  } blocks[] = {{"the robot file's values", &robot, sizeof robot},
                {"the robot file's values of its joints", robot.joints.data(), std::span(robot.joints).size_bytes()},
                {"the robot file's values of its devices", robot.devices.data(), std::span(robot.devices).size_bytes()},
                {"the robot file's values of its buses", robot.buses.data(), std::span(robot.buses).size_bytes()},
                {"the robot file's values of its sensors", robot.sensors.data(), std::span(robot.sensors).size_bytes()},
                {"the head of the shared memory", &shared.header, offsetof(wire::SegmentHeader, heartbeat_ns)},
                {"the robot's description in shared memory", &shared.robot_info, sizeof shared.robot_info}};
  for (const auto& [name, from, bytes] : blocks) {
    if (bytes == 0) continue;
    if (const Result<> watched = constants.watch(name, from, bytes); !watched) return watched;
  }
  return done();
}

// What of the containment of laws cannot be set up: told once, in the log and in the robot's status.
struct Missing {
  std::string words;
  void add(const std::string& sentence) {
    fmt::print(stderr, "lithe-spine: {}\n", sentence);
    if (words.find(sentence) == std::string::npos) words += (words.empty() ? "" : "; ") + sentence;
  }
  template <class T>
  void add_if(const Result<T>& result, const char* consequence) {
    if (!result) add(std::string(consequence) + ": " + result.message());
  }
};

// Looks at a law once in its budget: what it sees before the deadline ends exactly there. Each look wakes a core.
contain::WatchdogConfig watching(const robot::RobotConfig& robot) {
  const std::int64_t budget_ns = std::llround(1e9 / robot.rate_hz * robot.swap.budget_share);
  return {.look_every_ns = std::clamp<std::int64_t>(budget_ns * 3 / 4, 100'000, kNsPerMs), .grace_ns = budget_ns};
}

// The threads. Stop order: first the tick (it switches the drives off), then the Transport.
class Threads {
 public:
  Threads(const robot::RobotConfig& robot, const robot::CpuPlan& cpus, Memory& memory, Containment& containment,
          load::LawStore* arena, hal::Actuators& actuators)
      : robot_(robot),
        cpus_(cpus),
        memory_(memory),
        containment_(containment),
        actuators_(actuators),
        rehearsal_(*memory.spine, static_cast<std::uint32_t>(robot.joints.size()), 1.0 / robot.rate_hz,
                   *containment.loading),
        loader_(slot_, store_, *memory.spine, *memory.control, rehearsal_, arena),
        watchdog_(watching(robot)) {
    loop::start_clock(clock_);
  }

  // Returns the tick thread; it starts to tick when go() is called.
  pid_t start() {
    start_helpers();
    if (!cpus_.transport_inline) {
      transport_ = std::thread([this] {
        enter(cpus_.transport, true);
        const contain::Canary canary(constants_, "the Transport's stack");
        const bool shared = cpus_.transport == cpus_.housekeeping || cpus_.transport == cpus_.brain;
        if (shared) actuators_.share_core();
        loop::run_transport(handover_, actuators_, clock_, shared, stop_transport_);
      });
    }
    std::promise<pid_t> thread;
    ticking_ = std::thread([this, &thread] {
      enter(cpus_.spine, true);
      const contain::Canary canary(constants_, "the stack of the thread that ticks");
      thread.set_value(gettid());
      go_.get_future().wait();
      Result<contain::FaultBarrier> barrier = open_barrier(!cpus_.transport_inline, tick_lacks_);
      const loop::Wiring wiring{robot_,
                                *memory_.spine,
                                *memory_.control,
                                *memory_.brain,
                                slot_,
                                *containment_.ticking,
                                barrier ? &*barrier : nullptr,
                                handover_,
                                clock_,
                                cpus_.transport_inline ? &actuators_ : nullptr,
                                &constants_,
                                &supervised_};
      loop::Spine* spine = containment_.protected_memory->create<loop::Spine>(wiring);
      all_off_sent_ = spine->run(stop_tick_);
      std::destroy_at(spine);
    });
    return thread.get_future().get();
  }
  // Lets the tick begin. Returns what of the containment of laws is missing, of both threads that run laws; "" =
  // nothing.
  std::string go() {
    go_.set_value();
    const std::string tick = tick_lacks_.get_future().get(), loader = loader_lacks_.get_future().get();
    return tick.empty() || loader == tick ? loader : tick + (loader.empty() ? "" : "; ") + loader;
  }
  contain::Constants& constants() { return constants_; }

  // False: not every drive got the "off" command.
  bool stop() {
    stop_tick_.store(true, std::memory_order_relaxed);  // only the flag is passed
    ticking_.join();
    // release, with the acquire in run_transport(): the tick's last command is seen before it.
    stop_transport_.store(true, std::memory_order_release);
    if (transport_.joinable()) transport_.join();
    stop_helpers_.store(true, std::memory_order_relaxed);  // only the flag is passed
    loading_.join();
    watching_.join();
    keeper_.join();
    return all_off_sent_;
  }

 private:
  static void enter(int cpu, bool urgent) {
    if (const Result<> pinned = pin_this_thread(cpu); !pinned)
      fmt::print(stderr, "lithe-spine: {}\n", pinned.message());
    urgent ? (void)raise_priority() : ordinary_priority();
    touch_stack();
  }

  void start_helpers() {
    keeper_ = std::thread([this] {
      enter(cpus_.housekeeping, false);
      keep();
    });
    watching_ = std::thread([this] {
      enter(cpus_.housekeeping, true);  // without it nothing ends an endless law
      const contain::Canary canary(constants_, "the Watchdog's stack");
      watchdog_.run(stop_helpers_);
    });
    loading_ = std::thread([this] {
      enter(cpus_.housekeeping, false);
      const contain::Canary canary(constants_, "the Loader's stack");
      Result<contain::FaultBarrier> barrier = open_barrier(false, loader_lacks_);
      rehearsal_.use(barrier ? &*barrier : nullptr);
      loader_.run(stop_helpers_);
    });
  }

  // Updates the clock's fit, looks for a supervisor, and checks the constant memory.
  void keep() {
    const contain::Canary canary(constants_, "the keeper's stack");
    constexpr timespec kEvery{0, loop::ClockKeeper::kEveryNs};
    loop::ClockKeeper clock(clock_);
    const char* told = nullptr;
    while (!stop_helpers_.load(std::memory_order_relaxed)) {
      nanosleep(&kEvery, nullptr);
      clock.renew();
      supervised_.store(memory_.supervisor.is_held(), std::memory_order_relaxed);  // partner: Inbox::supervised()
      const char* const damaged = constants_.look();
      if (damaged != told) fmt::print(stderr, "lithe-spine: memory that must not change has changed: {}\n", damaged);
      told = damaged;
    }
  }

  // Opens this thread's FaultBarrier. Without it a crash of a law ends the process. A seccomp filter would also limit
  // this thread's own calls, so it is used only for a thread that makes none.
  Result<contain::FaultBarrier> open_barrier(bool only_waits, std::promise<std::string>& told) {
    Missing missing;
    Result<contain::FaultBarrier> barrier = contain::FaultBarrier::open(containment_.protected_memory.get());
    missing.add_if(barrier, "a law that crashes will end this process");
    if (barrier) {
      missing.add_if(watchdog_.watch(*barrier), "an endless law will not be stopped");
      missing.add_if(barrier->watch_entrance(constants_), "what a handler reads first is not checked");
      if (only_waits)
        missing.add_if(barrier->forbid_system_calls(), "a law can make system calls");
      else if (barrier->dispatch_system_calls() == contain::CallGate::none)
        missing.add("a law can make system calls: this kernel has no syscall user dispatch");
    }
    told.set_value(missing.words);
    return barrier;
  }

  const robot::RobotConfig& robot_;
  robot::CpuPlan cpus_;
  Memory& memory_;
  Containment& containment_;
  hal::Actuators& actuators_;
  loop::ClockMemory clock_{};
  loop::Handover handover_;
  law::Slot slot_;
  load::DlopenStore store_;
  load::Rehearsal rehearsal_;
  load::Loader loader_;
  contain::Watchdog watchdog_;
  contain::Constants constants_;
  std::promise<void> go_;
  std::promise<std::string> tick_lacks_, loader_lacks_;  // of the containment; "" = nothing
  std::atomic<bool> stop_tick_{false}, stop_transport_{false}, stop_helpers_{false};
  std::atomic<bool> supervised_{memory_.supervisor.is_held()};
  bool all_off_sent_ = false;  // result of the tick thread's shutdown
  std::thread keeper_, watching_, loading_, transport_, ticking_;
};

// Waits for SIGINT or SIGTERM, and reopens buses whose hardware was lost. Does not stop when the parent dies: the next
// supervisor adopts this process.
void look_after(hal::Actuators& actuators, const sigset_t& signals) {
  constexpr timespec kEvery{0, 500'000'000};
  std::string told;
  while (sigtimedwait(&signals, nullptr, &kEvery) < 0) {
    actuators.service();
    const std::string problem = actuators.why_not_ready();
    if (problem != told)
      fmt::print(stderr, "lithe-spine: {}\n", problem.empty() ? "all buses and drives are well" : problem);
    told = problem;
  }
}

// Runs until a signal ends it. Every static variable must have its value before: the pages are read-only then.
// `announce` is called when the tick has begun, with what of the containment of laws is missing ("" = nothing).
template <class Announce>
void run_sealed(Threads& threads, hal::Actuators& actuators, const sigset_t& signals, Announce announce) {
  const Result<contain::SealedStatics> sealed = contain::SealedStatics::seal();
  Missing missing;
  missing.add_if(sealed, "a law can write the Spine's variables");
  const std::string lacks = threads.go();
  announce(missing.words + (missing.words.empty() || lacks.empty() ? "" : "; ") + lacks);
  look_after(actuators, signals);
}

// Those that end the Spine. Every thread inherits the mask: only the one that waits for them handles them.
sigset_t block_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGINT);
  sigaddset(&signals, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  signal(SIGPIPE, SIG_IGN);
  return signals;
}

// --check: errors of the file that the start would find, without starting: cores, and the joints of a model.
// The joints of a model are known to the simulation only.
int check(const std::string& path, const hal::MakeSimulation& make_simulation) {
  Result<robot::RobotConfig> robot = robot::load_robot(path);
  if (!robot) return refuse(kExitUsage, robot.message());
  const Result<robot::CpuPlan> cpus = robot::plan_cpus(*robot, machine_cores());
  if (!cpus) return refuse(kExitUsage, robot->path + ": " + cpus.message());
  if (robot->plant.kind != robot::PlantKind::mujoco || !make_simulation) return 0;
  for (robot::BusConfig& bus : robot->buses) bus.kind = robot::BusKind::loop;
  const auto simulated = make_simulation(*robot);
  return simulated ? 0 : refuse(kExitUsage, robot->path + ": " + simulated.message());
}

int run(const std::string& path, const hal::MakeSimulation& make_simulation) {
  Result<robot::RobotConfig> robot = robot::load_robot(path);
  if (!robot) return refuse(kExitUsage, robot.message());

  const sigset_t signals = block_signals();
  use_small_stacks();  // before the first thread: glibc reuses its stack
  const MachineCores cores = machine_cores();
  const Result<robot::CpuPlan> cpus = robot::plan_cpus(*robot, cores);
  if (!cpus) return refuse(kExitUsage, cpus.message());
  for (std::string& cost : robot::costs_of(*cpus, robot->spine, cores)) robot->notes.push_back(std::move(cost));
  Result<Memory> memory = make_memory(robot->name);
  if (!memory) return refuse(kExitRefused, memory.message());
  FrameRing tap(*memory->frames, *robot, RawClock::calibrate());
  Result<std::unique_ptr<hal::Actuators>> actuators =
      hal::open_actuators(*robot, {.make_simulation = make_simulation, .tap = &tap});
  if (!actuators) {
    remove_memory(robot->name);
    return refuse(kExitFault, actuators.message());
  }
  if (cpus->spine_shares) robot->spine.release = robot::Release::sleep;
  freeze_malloc();
  const Result<std::unique_ptr<load::ArenaStore>> arena = attach_code_arena(*robot);
  if (!arena) robot->notes.push_back(arena.message());
  std::string notes = describe_host(robot->notes);
  if (const Result<> pinned = pin_this_thread(cpus->housekeeping); !pinned)
    fmt::print(stderr, "{}\n", pinned.message());

  Result<Containment> containment = contain_laws();
  if (!containment) {
    remove_memory(robot->name);
    return refuse(kExitRefused, containment.message());
  }
  load::LawStore* const code = keep_store(arena, *containment->protected_memory);
  auto* threads =
      containment->protected_memory->create<Threads>(*robot, *cpus, *memory, *containment, code, **actuators);
  Own own{threads->start(), containment->protected_memory->protection() == contain::Protection::keys, code != nullptr};
  write_robot_info(memory->spine->robot_info, *robot, *cpus, notes, own);
  run_sealed(*threads, **actuators, signals, [&](const std::string& lacks) {
    if (!lacks.empty()) {
      notes = lacks + (notes.empty() ? "" : "; ") + notes;
      write_robot_info(memory->spine->robot_info, *robot, *cpus, notes, own);
    }
    if (const Result<> watched = watch_constants(threads->constants(), *robot, *memory); !watched)
      fmt::print(stderr, "lithe-spine: {}\n", watched.message());
    fmt::print("{}\n", ready_line(*robot, *cpus, notes));
    std::fflush(stdout);
  });
  const bool all_off_sent = threads->stop();
  std::destroy_at(threads);
  if (code != nullptr) std::destroy_at(code);
  if (const std::string odd = describe_replies(**actuators); !odd.empty()) fmt::print(stderr, "lithe-spine: {}\n", odd);
  remove_memory(robot->name);
  if (all_off_sent) return 0;
  fmt::print(stderr, "lithe-spine: not every drive has heard that it is off; their watchdogs have to stop them\n");
  return kExitFault;
}

}  // namespace

int run_process(int argc, char** argv, const hal::MakeSimulation& make_simulation) {
  const bool checks = argc == 3 && std::string_view(argv[1]) == "--check";
  if (argc != 2 && !checks) {
    std::fputs(
        "usage: lithe-spine [--check] ROBOT.toml\n  `lithe run ROBOT.toml` starts it together with all it needs\n",
        stderr);
    return kExitUsage;
  }
  return checks ? check(argv[2], make_simulation) : run(argv[1], make_simulation);
}

}  // namespace lithe
