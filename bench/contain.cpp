// SPDX-License-Identifier: Apache-2.0
// The time that containment adds to a correct law, and the time from a law's fault to the end of the next law's step.
//
// The ways of calling take turns in blocks of calls on one core, under a Watchdog on the partner core. The negative
// control saves the signal mask in every call, as a plain sigsetjmp would; it must be slower.
#include <setjmp.h>

#include <array>
#include <atomic>
#include <ctime>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/contain/memory/protected_memory.hpp"
#include "spine/contain/test/bad_laws_rig.hpp"
#include "spine/contain/watchdog.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/time.hpp"

namespace lithe::bench {
namespace {

constexpr int kBlocks = 400, kCallsPerBlock = 2000, kFaults = 300;
constexpr std::int64_t kBudgetNs = 200 * kNsPerUs;
constexpr std::int64_t kNoDeadline = INT64_MAX;
constexpr std::size_t kCopiedBytes = 4096;
constexpr double kControlAtLeast = 2.0;

// One way of calling a law.
struct Way {
  const char* key;
  void (*calls)(contain::FaultBarrier* barrier);  // kCallsPerBlock of them
  bool in_cell = true, in_vault = false, gated = false;
  std::size_t copied_bytes = 0;
  std::vector<std::int64_t> block_ns = {};

  double per_call_ns() const { return static_cast<double>(quantile_ns(block_ns, 0.5)) / kCallsPerBlock; }
};

// A running Watchdog on the partner core, and its share of that core.
class Guarded {
 public:
  Guarded(int cpu, const contain::WatchdogConfig& config) : dog(config) {
    thread_ = on_core(cpu, [this] {
      raise_priority();
      const ThreadToll from = thread_toll();
      dog.run(stop_);
      had_.add(from, thread_toll());
    });
  }
  ~Guarded() { stop(); }
  // Returns its share of the core.
  double stop() {
    stop_.store(true);
    if (thread_.joinable()) thread_.join();
    return had_.share();
  }
  contain::Watchdog dog;

 private:
  Had had_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

int g_runs = 0;

void call_plain(contain::FaultBarrier*) {
  void (*volatile law)(void*) = contain::bad::count;  // nobody knows at compile time which law it is
  for (int i = 0; i < kCallsPerBlock; ++i) law(&g_runs);
}

void call_contained(contain::FaultBarrier* barrier) {
  for (int i = 0; i < kCallsPerBlock; ++i) barrier->run(kNoDeadline, contain::bad::count, &g_runs);
}

void call_saving_mask(contain::FaultBarrier*) {
  static sigjmp_buf back;
  static int i = 0;  // setjmp may forget a local
  for (i = 0; i < kCallsPerBlock; ++i)
    if (sigsetjmp(back, 1) == 0) contain::bad::count(&g_runs);
}

// A thread for each block, because a thread has one FaultBarrier; all on one core, one after the other.
void measure_block(Way& way, int cpu, contain::Watchdog& dog) {
  on_core(cpu, [&] {
    raise_priority();
    const bool copies = way.copied_bytes > 0;
    auto protected_memory = or_exit(
        contain::ProtectedMemory::make(1 << 16, copies ? contain::Protection::copies : contain::Protection::best));
    if (copies) or_exit(protected_memory->guard(protected_memory->allocate(way.copied_bytes), way.copied_bytes));
    contain::FaultBarrier barrier =
        or_exit(contain::FaultBarrier::open(way.in_vault ? protected_memory.get() : nullptr));
    or_exit(dog.watch(barrier));
    if (way.gated) or_exit(barrier.forbid_system_calls());
    way.calls(&barrier);
    const std::int64_t from_ns = monotonic_ns();
    way.calls(&barrier);
    way.block_ns.push_back(monotonic_ns() - from_ns);
  }).join();
}

void report_calls(Cores cores, JsonLine& line) {
  std::vector<Way> ways{{"plain", call_plain, false},
                        {"contained", call_contained},
                        {"contained_keys", call_contained, true, true},
                        {"contained_copies_4k", call_contained, true, true, false, kCopiedBytes},
                        {"contained_gated", call_contained, true, false, true},
                        {"control", call_saving_mask, false}};
  Guarded guarded(cores.partner, {});
  for (int block = 0; block < kBlocks; ++block)
    for (Way& way : ways) measure_block(way, cores.spine, guarded.dog);
  for (const Way& way : ways) line.number(std::string("contain_call_ns_") + way.key, way.per_call_ns());
  const double cost_ns = ways[1].per_call_ns() - ways[0].per_call_ns();
  const double control_ns = ways.back().per_call_ns() - ways[0].per_call_ns();
  line.number("contain_cost_ns", cost_ns);
  line.number("contain_control_over_cost", control_ns / cost_ns);
  line.flag("contain_control_failed_as_it_must", control_ns >= kControlAtLeast * cost_ns);
}

// From the start of a law that fails to the end of the step that stands in for it.
std::int64_t away_ns(contain::FaultBarrier& barrier, const contain::bad::Case& bad, std::int64_t deadline_ns) {
  const std::int64_t from_ns = monotonic_ns();
  const contain::Failure trouble = barrier.run(deadline_ns, bad.call, nullptr);
  barrier.run(kNoDeadline, contain::bad::count, &g_runs);
  const std::int64_t to_ns = monotonic_ns();
  if (trouble.kind != bad.kind)
    give_up(std::string(bad.name) + " ended as " + std::to_string(static_cast<unsigned>(trouble.kind)));
  return to_ns - from_ns;
}

void report_crashes(Cores cores, JsonLine& line) {
  std::array<std::vector<std::int64_t>, contain::bad::kCrashes.size()> taken_ns;
  use_small_stacks();  // as the Spine does
  on_core(cores.spine, [&] {
    raise_priority();
    contain::FaultBarrier barrier = or_exit(contain::FaultBarrier::open());
    for (int round = 0; round < kFaults; ++round)
      for (std::size_t i = 0; i < taken_ns.size(); ++i)
        taken_ns[i].push_back(away_ns(barrier, contain::bad::kCrashes[i], kNoDeadline));
  }).join();
  for (std::size_t i = 0; i < taken_ns.size(); ++i)
    line.quantiles(std::string("contain_") + contain::bad::kCrashes[i].name, taken_ns[i]);
}

// The time from the deadline of an endless law to its end.
void report_loops(Cores cores, const char* key, const contain::WatchdogConfig& config, JsonLine& line) {
  constexpr contain::bad::Case kLoop{"loop_forever", contain::bad::loop_forever, wire::LawFaultKind::overran};
  std::vector<std::int64_t> late_ns;
  Guarded guarded(cores.partner, config);
  on_core(cores.spine, [&] {
    raise_priority();
    contain::FaultBarrier barrier = or_exit(contain::FaultBarrier::open());
    or_exit(guarded.dog.watch(barrier));
    for (int i = 0; i < kFaults; ++i) {
      late_ns.push_back(away_ns(barrier, kLoop, monotonic_ns() + kBudgetNs) - kBudgetNs);
      const timespec rest{0, 300'000 + i * 1'000};  // not in step with the Watchdog
      nanosleep(&rest, nullptr);
    }
  }).join();
  line.quantiles(std::string("contain_loop_past_deadline_") + key, late_ns);
}

// What the Watchdog takes of its core while a law of a microsecond runs every millisecond.
void report_watchdog(Cores cores, JsonLine& line) {
  Guarded guarded(cores.partner, {});
  on_core(cores.spine, [&] {
    contain::FaultBarrier barrier = or_exit(contain::FaultBarrier::open());
    or_exit(guarded.dog.watch(barrier));
    for (int i = 0; i < 2000; ++i) {
      barrier.run(monotonic_ns() + kBudgetNs, contain::bad::count, &g_runs);
      const timespec rest{0, 1'000'000};
      nanosleep(&rest, nullptr);
    }
  }).join();
  line.number("contain_watchdog_core_share", guarded.stop());
}

}  // namespace
}  // namespace lithe::bench

int main() {
  using namespace lithe::bench;
  const Cores cores = pick_cores();
  pin_or_exit(cores.partner);
  or_exit(lithe::contain::install_handlers());
  JsonLine line;
  report_calls(cores, line);
  report_crashes(cores, line);
  report_loops(cores, "polled", {}, line);
  lithe::contain::WatchdogConfig spinning;
  spinning.look_every_ns = 0;
  report_loops(cores, "spun", spinning, line);
  report_watchdog(cores, line);
  line.print();
  return 0;
}
