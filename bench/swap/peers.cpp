// SPDX-License-Identifier: Apache-2.0
// Laws replaced in the usual ways, in a simple loop at 1 kHz with LITHE's release: the peers of `make bench-swap`.
//
//   bench_swap_peers CORE LOADER_CORE TICKS_FILE COMPILE_COMMAND LAW.so LAW.so ...
//
// Reads lines `WAY SWAPS GAP_TICKS PAUSE_TICKS` and runs a block for each: that many swaps, GAP_TICKS apart, and a
// pause. Every tick goes to TICKS_FILE as a TickRecord; the answer is {"windows":[[asked_ns, done_ns], ...]}. Ways:
//   dlopen   in the loop's own thread, between two ticks, like plugin systems: after a tick's command has been sent
//   mutex    a second thread loads, swaps and closes behind a mutex that the loop takes every tick
//   brief    the same, but it loads before and closes after: only the exchange is inside the lock
//   compile  as dlopen, but the loop's thread also runs the compiler: the negative control, which must lose ticks
// No state is carried and no output is blended, as in those systems.
#include <dlfcn.h>
#include <spawn.h>
#include <sys/wait.h>

#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <memory>
#include <mutex>
#include <semaphore>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/machine.hpp"
#include "lithe/law.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/hal/physics/plant.hpp"
#include "spine/loop/clock.hpp"

namespace lithe::bench {
namespace {

constexpr std::int64_t kPeriodNs = kNsPerMs;
constexpr std::int64_t kPhaseNs = 500 * kNsPerUs;
constexpr std::uint32_t kSettleTicks = 20;

// bench/swap/peers.py reads these bytes from the file.
struct TickRecord {
  std::int64_t release_ns, woke_ns, output_ns;
  std::uint32_t skipped, switches, faults, pad;
  double torque_nm;
};

struct Loaded {
  void* handle = nullptr;
  const LitheLaw* law = nullptr;
};

Loaded load(const std::string& path) {
  Loaded loaded;
  loaded.handle = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (loaded.handle == nullptr) give_up(path + ": cannot be loaded");
  loaded.law = static_cast<const LitheLaw*>(dlsym(loaded.handle, "lithe_law"));
  if (loaded.law == nullptr) give_up(path + ": is no law");
  return loaded;
}

// The law that runs, started from its defaults.
class Active {
 public:
  Loaded exchange(Loaded next) {
    for (std::uint32_t i = 0; i < next.law->param_count; ++i)
      params_[i] = {next.law->params[i].value, next.law->params[i].min, next.law->params[i].max};
    std::memcpy(state_.data(), next.law->state_defaults, next.law->state_size);
    return std::exchange(loaded_, next);
  }
  void step(const Tick& tick, Effort& effort) {
    std::array<double, kMaxProbes> probes{};
    loaded_.law->step(&tick, params_.data(), state_.data(), &effort, probes.data());
  }

 private:
  Loaded loaded_;
  std::array<Param, kMaxParams> params_{};
  alignas(64) std::array<std::byte, kMaxStateBytes> state_{};
};

// The arm of robots/arm.toml and the sine it follows.
class Arm {
 public:
  double tick(Active& active, std::int64_t release_ns) {
    const double w = 3.14159265, t_s = static_cast<double>(release_ns % (100 * kNsPerS)) * 1e-9;
    in_.dt_s = 1e-3;
    in_.joints = 1;
    in_.position_rad[0] = plant_.position_rad();
    in_.velocity_rad_s[0] = plant_.velocity_rad_s();
    in_.setpoint_position_rad[0] = 0.8 * std::sin(w * t_s);
    in_.setpoint_velocity_rad_s[0] = 0.8 * w * std::cos(w * t_s);
    effort_.clear(1);
    active.step(in_, effort_);
    torque_nm_ = std::clamp(effort_.torque_nm[0], -0.6, 0.6);
    return torque_nm_;
  }
  void move() {
    for (int i = 0; i < 20; ++i) plant_.step(torque_nm_);
  }

 private:
  hal::sim::Plant plant_{{.inertia_kg_m2 = 2.55e-3,
                          .mgl_nm = 0.165,
                          .viscous_nm_s_rad = 3e-5,
                          .coulomb_nm = 0.0132,
                          .torque_lag_s = 1e-3}};
  Tick in_;
  Effort effort_;
  double torque_nm_ = 0;
};

// Contract: run() on the loop's thread; the loader thread is its own
class Peer {
 public:
  Peer(std::string compile, std::vector<std::string> laws, int loader_core);
  ~Peer();

  struct Window {
    std::int64_t asked_ns, done_ns;
  };
  struct Order {
    std::string way;
    std::uint32_t swaps = 0, gap_ticks = 0, pause_ticks = 0;
  };
  void run(const Order& order, std::vector<Window>& windows, std::vector<TickRecord>& ticks);

 private:
  const std::string& next_law() { return laws_[++swaps_ % laws_.size()]; }
  void ask(const std::string& way);
  void swap_here(bool compile);
  void serve();

  std::string compile_;
  std::vector<std::string> laws_;
  std::size_t swaps_ = 0;
  Active active_;
  Arm arm_;
  std::unique_ptr<loop::ClockMemory> clock_memory_ = std::make_unique<loop::ClockMemory>();

  std::mutex mutex_;  // around the active law, for the ways that have one
  std::binary_semaphore asked_{0};
  bool brief_ = false;                 // written before asked_ is released
  std::atomic<std::int64_t> done_ns_;  // of the last swap; 0 = one is under way
  std::atomic<bool> stop_{false};
  std::thread loader_;
};

Peer::Peer(std::string compile, std::vector<std::string> laws, int loader_core)
    : compile_(std::move(compile)), laws_(std::move(laws)), done_ns_(1) {
  loop::start_clock(*clock_memory_);
  active_.exchange(load(laws_[0]));
  loader_ = on_core(loader_core, [this] { serve(); });
}

Peer::~Peer() {
  stop_.store(true);
  asked_.release();
  loader_.join();
}

void Peer::serve() {
  ordinary_priority();
  while (true) {
    asked_.acquire();
    if (stop_.load()) return;
    if (brief_) {
      const Loaded next = load(next_law());
      std::unique_lock lock(mutex_);
      const Loaded old = active_.exchange(next);
      lock.unlock();
      dlclose(old.handle);
    } else {
      const std::lock_guard lock(mutex_);
      dlclose(active_.exchange(load(next_law())).handle);
    }
    done_ns_.store(monotonic_ns());
  }
}

void Peer::swap_here(bool compile) {
  if (compile) {
    std::array<std::string, 3> words = {"sh", "-c", compile_};
    std::array<char*, 4> argv = {words[0].data(), words[1].data(), words[2].data(), nullptr};
    pid_t child = 0;
    int status = 0;
    if (posix_spawn(&child, "/bin/sh", nullptr, nullptr, argv.data(), environ) != 0) give_up("sh: cannot be run");
    if (waitpid(child, &status, 0) != child || status != 0) give_up(compile_ + ": does not compile");
  }
  dlclose(active_.exchange(load(next_law())).handle);
  done_ns_.store(monotonic_ns());
}

void Peer::ask(const std::string& way) {
  done_ns_.store(0);
  if (way == "dlopen" || way == "compile") return swap_here(way == "compile");
  brief_ = way == "brief";
  asked_.release();
}

void Peer::run(const Order& order, std::vector<Window>& windows, std::vector<TickRecord>& ticks) {
  const std::size_t most = kSettleTicks + std::size_t{order.swaps} * order.gap_ticks + order.pause_ticks + 100'000;
  std::vector<Cycle> cycles;
  cycles.reserve(most);  // nothing is allocated between the ticks
  ticks.reserve(most);
  windows.reserve(order.swaps);
  loop::SteeredClock clock(*clock_memory_);
  std::uint32_t due = kSettleTicks;
  const auto more = [&](std::int64_t release_ns) {
    if (!windows.empty() && windows.back().done_ns == 0) windows.back().done_ns = done_ns_.load();
    const bool busy = windows.size() < order.swaps || windows.back().done_ns == 0;
    return ticks.size() < most && (busy || release_ns < windows.back().done_ns + order.pause_ticks * kPeriodNs);
  };
  const auto tick = [&](std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped, Cycle& cycle, Cycle*) {
    std::unique_lock lock(mutex_, std::defer_lock);
    if (order.way == "mutex" || order.way == "brief") lock.lock();
    const double torque_nm = arm_.tick(active_, release_ns);
    if (lock.owns_lock()) lock.unlock();
    const std::int64_t output_ns = clock.now_ns();
    arm_.move();
    cycle.handoff_ns = output_ns - woke_ns;
    ticks.push_back({release_ns, woke_ns, output_ns, skipped, 0, 0, 0, torque_nm});
    const bool idle = windows.empty() || windows.back().done_ns != 0;
    if (idle && windows.size() < order.swaps && ticks.size() > due) {
      due = static_cast<std::uint32_t>(ticks.size()) - 1 + order.gap_ticks;
      windows.push_back({monotonic_ns(), 0});
      ask(order.way);  // after the command: only the next tick can be late because of it
    }
  };
  run_while(clock, kPeriodNs, kPhaseNs, more, cycles, tick);
  std::size_t at = 0;
  for (const Cycle& cycle : cycles) {  // those that were skipped have no hand-off
    if (cycle.handoff_ns == kUnknownNs) continue;
    ticks[at].switches = static_cast<std::uint32_t>(cycle.switches);
    ticks[at++].faults = static_cast<std::uint32_t>(cycle.faults);
  }
}

void answer(const std::vector<Peer::Window>& windows) {
  std::printf("{\"windows\":[");
  for (std::size_t i = 0; i < windows.size(); ++i) {
    std::printf("%s[%lld,%lld]", i == 0 ? "" : ",", static_cast<long long>(windows[i].asked_ns),
                static_cast<long long>(windows[i].done_ns));
  }
  std::printf("]}\n");
  std::fflush(stdout);
}

int serve_orders(int core, bool shared, const char* ticks_file, Peer& peer) {
  std::FILE* file = std::fopen(ticks_file, "wb");
  if (file == nullptr) give_up(std::string(ticks_file) + ": cannot be written");
  pin_or_exit(core);
  if (!shared) raise_priority();  // a spinning loop would take all time from the process that controls it
  if (const auto locked = lock_memory(); !locked) std::fprintf(stderr, "bench: %s\n", locked.message().c_str());
  answer({});  // ready
  Peer::Order order;
  while (std::cin >> order.way >> order.swaps >> order.gap_ticks >> order.pause_ticks && order.swaps > 0) {
    std::vector<Peer::Window> windows;
    std::vector<TickRecord> ticks;
    peer.run(order, windows, ticks);
    std::fwrite(ticks.data(), sizeof(TickRecord), ticks.size(), file);
    std::fflush(file);
    answer(windows);
  }
  std::fclose(file);
  return 0;
}

}  // namespace
}  // namespace lithe::bench

int main(int argc, char** argv) {
  using namespace lithe::bench;
  if (argc < 7) give_up("usage: bench_swap_peers CORE LOADER_CORE TICKS_FILE COMPILE_COMMAND LAW.so LAW.so ...");
  const int core = std::atoi(argv[1]), loader_core = std::atoi(argv[2]);
  Peer peer(argv[4], {argv + 5, argv + argc}, loader_core);
  return serve_orders(core, core == loader_core, argv[3], peer);
}
