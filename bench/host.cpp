// SPDX-License-Identifier: Apache-2.0
// The effect of this machine on new memory and on a spinning thread: the numbers of docs/rt.md. One line of JSON.
// bench_host [ROUNDS]: each round measures every condition once.
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/realtime.hpp"

namespace lithe::bench {
namespace {

constexpr std::int64_t kPeriodNs = kNsPerMs;
constexpr std::int64_t kPhaseNs = 500'000;  // the Spine's
constexpr std::int64_t kBlockNs = 500 * kNsPerMs;
constexpr std::int64_t kLateNs = 2'000;
constexpr std::size_t kPageBytes = 4096, kPages = 512;
constexpr int kTouchesPerRound = 4;
constexpr double kControlAtLeast =
    0.2;  // of the releases: an equal thread on the same core must cost at least this share

// First and second write to each page of new memory.
struct Touches {
  std::vector<std::int64_t> first_ns, again_ns;
};

void touch_fresh_pages(const RawClock& clock, Touches& touches) {
  constexpr std::size_t kBytes = kPages * kPageBytes;
  void* fresh = mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (fresh == MAP_FAILED) return;
  madvise(fresh, kBytes, MADV_NOHUGEPAGE);  // the Spine uses small pages too
  auto* bytes = static_cast<volatile char*>(fresh);
  for (std::vector<std::int64_t>* times_ns : {&touches.first_ns, &touches.again_ns}) {
    for (std::size_t page = 0; page < kPages; ++page) {
      const std::int64_t before_ns = clock.now_ns();
      bytes[page * kPageBytes] = 1;
      times_ns->push_back(clock.now_ns() - before_ns);
    }
  }
  munmap(fresh, kBytes);
}

// The releases of all blocks of one condition.
struct Spun {
  std::vector<Cycle> cycles;
  double skipped = 0;
  double skipped_share() const { return cycles.empty() ? 0 : skipped / static_cast<double>(cycles.size()); }
  double late_share() const { return share_above(figure_ns(cycles, &Cycle::late_ns, true), kLateNs); }
};

// The clock that the blocks read, adjusted before each block: the kernel's timer tick is on its whole milliseconds.
struct Time {
  std::unique_ptr<loop::ClockMemory> memory = std::make_unique<loop::ClockMemory>();
  loop::ClockKeeper keeper{(loop::start_clock(*memory), *memory)};
  loop::SteeredClock clock{*memory};
};

void spin_block(Time& time, std::int64_t phase_ns, Spun& spun) {
  time.keeper.renew();
  run_block(time.clock, kPeriodNs, phase_ns, kBlockNs, spun.cycles,
            [&](std::int64_t, std::int64_t, std::uint32_t skipped, Cycle&, Cycle*) { spun.skipped += skipped; });
}

std::string set_nice(int value) {
  return setpriority(PRIO_PROCESS, 0, value) == 0 ? "" : "nice " + std::to_string(value) + ": " + std::strerror(errno);
}

std::string why_no_sessions() {
  const auto enabled = read_regular_file("/proc/sys/kernel/sched_autogroup_enabled", 16);
  if (!enabled) return enabled.message();
  return enabled->starts_with('1') ? "" : "kernel.sched_autogroup_enabled is 0: this kernel does not group by session";
}

std::string set_session_nice(const char* value) {
  const int fd = open("/proc/self/autogroup", O_WRONLY | O_CLOEXEC);
  if (fd < 0) return std::string("/proc/self/autogroup: ") + std::strerror(errno);
  const bool written = write(fd, value, std::strlen(value)) > 0;
  const std::string why = written ? "" : std::string("/proc/self/autogroup: ") + std::strerror(errno);
  close(fd);
  return why;
}

// A program in another session that spins on the core with nice 10, like one of our compilers.
class OtherSession {
 public:
  explicit OtherSession(int cpu) : pid_(fork()) {
    if (pid_ != 0) return;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    setsid();
    pin_or_exit(cpu);
    set_nice(10);
    for (;;) spin_pause();
  }
  ~OtherSession() {
    if (pid_ <= 0) return;
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
  }
  OtherSession(const OtherSession&) = delete;
  OtherSession& operator=(const OtherSession&) = delete;

 private:
  pid_t pid_;
};

void spin_for(std::int64_t ns, Had& had) {
  const ThreadToll before = thread_toll();
  while (monotonic_ns() < before.wall_ns + ns) spin_pause();
  had.add(before, thread_toll());
}

struct Runs {
  Touches touches;
  std::array<Spun, 3> grids;          // in the order of kPhases
  Spun alone, beside, raised_beside;  // ordinary threads on the core: none, one, one while we have nice -20
  Had plain_session, raised_session;  // nice -20, and nice 10 in another session
  std::string nice_absent, session_absent;
};

constexpr std::array<std::int64_t, 3> kPhases = {0, kPhaseNs, kPhaseNs / 2};

void measure_nice(int cpu, Time& time, Runs& runs) {
  spin_block(time, kPhaseNs, runs.alone);
  const Competitor competitor(cpu, ordinary_priority);
  spin_block(time, kPhaseNs, runs.beside);
  if (runs.nice_absent = set_nice(-20); !runs.nice_absent.empty()) return;
  spin_block(time, kPhaseNs, runs.raised_beside);
  set_nice(0);
}

void measure_sessions(int cpu, Runs& runs) {
  if (runs.session_absent = why_no_sessions(); !runs.session_absent.empty()) return;
  if (runs.session_absent = set_nice(-20); !runs.session_absent.empty()) return;
  const OtherSession other(cpu);
  for (const auto& [value, had] : {std::pair{"0", &runs.plain_session}, std::pair{"-20", &runs.raised_session}}) {
    if (runs.session_absent = set_session_nice(value); !runs.session_absent.empty()) break;
    spin_for(kBlockNs, *had);
  }
  set_session_nice("0");
  set_nice(0);
}

Runs measure(int cpu, int rounds) {
  Runs runs;
  Time time;
  for (int round = 0; round < rounds; ++round) {
    for (int i = 0; i < kTouchesPerRound; ++i) touch_fresh_pages(time.clock.raw(), runs.touches);
    for (std::size_t i = 0; i < kPhases.size(); ++i) spin_block(time, kPhases[i], runs.grids[i]);
    measure_nice(cpu, time, runs);
    measure_sessions(cpu, runs);
  }
  return runs;
}

void report(const Runs& runs) {
  std::vector<Cycle> quiet = runs.alone.cycles;
  for (const Spun& grid : runs.grids) quiet.insert(quiet.end(), grid.cycles.begin(), grid.cycles.end());
  const auto p50 = [](const std::vector<std::int64_t>& ns) { return static_cast<double>(quantile_ns(ns, 0.5)); };
  JsonLine line;
  line.quantiles("host_touch_first", runs.touches.first_ns)
      .quantiles("host_touch_again", runs.touches.again_ns)
      .flag("host_touch_control_failed_as_it_must",
            p50(runs.touches.first_ns) >= 3 * std::max(p50(runs.touches.again_ns), 1.0))
      .number("host_grid_whole_late_share", runs.grids[0].late_share())
      .number("host_grid_moved_late_share", runs.grids[1].late_share())
      .number("host_grid_quarter_late_share", runs.grids[2].late_share())
      .number("host_grid_control_difference", std::abs(runs.grids[1].late_share() - runs.grids[2].late_share()))
      .quantiles("host_grid_whole", figure_ns(runs.grids[0].cycles, &Cycle::late_ns, true))
      .quantiles("host_grid_moved", figure_ns(runs.grids[1].cycles, &Cycle::late_ns, true))
      .quantiles("host_grid_quarter", figure_ns(runs.grids[2].cycles, &Cycle::late_ns, true))
      .number("host_stolen_share", stolen_share(quiet))
      .number("host_preempted_share", preempted_share(quiet))
      .number("host_nice_alone_skipped_share", runs.alone.skipped_share())
      .number("host_nice_ordinary_skipped_share", runs.beside.skipped_share())
      .flag("host_nice_control_failed_as_it_must", runs.beside.skipped_share() >= kControlAtLeast);
  if (runs.nice_absent.empty()) line.number("host_nice_raised_skipped_share", runs.raised_beside.skipped_share());
  if (runs.session_absent.empty()) {
    line.number("host_session_plain_core_share", runs.plain_session.share())
        .number("host_session_raised_core_share", runs.raised_session.share());
  }
  line.word("host_nice_absent", runs.nice_absent).word("host_session_absent", runs.session_absent).print();
}

}  // namespace
}  // namespace lithe::bench

int main(int argc, char** argv) {
  using namespace lithe::bench;
  const int rounds = argc > 1 ? std::atoi(argv[1]) : 12;
  if (rounds < 1) {
    std::fprintf(stderr, "usage: bench_host [ROUNDS]\n");
    return 2;
  }
  const Cores cores = pick_cores();
  pin_or_exit(cores.spine);
  report(measure(cores.spine, rounds));
  return 0;
}
