// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/measure/measure.hpp"

#include <sys/resource.h>
#include <time.h>

#include <algorithm>
#include <cmath>
#include <thread>
#include <vector>

#include "host/read/machine.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/time.hpp"

namespace lithe::host {
namespace {

constexpr std::int64_t kGapNs = kNsPerUs;
constexpr std::int64_t kAskNs = 5 * kNsPerUs;  // a longer gap is worth asking the kernel for its reason
constexpr std::size_t kMostGapsPerS = 50'000;
constexpr std::size_t kMostGaps = 8'000'000;

std::int64_t own_cpu_ns() {
  timespec used{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &used);
  return used.tv_sec * kNsPerS + used.tv_nsec;
}

rusage own_usage() {
  rusage usage{};
  getrusage(RUSAGE_THREAD, &usage);
  return usage;
}

// What the kernel counts for a core, before and after.
struct Counts {
  Result<CoreInterrupts> interrupts;
  std::optional<long long> stolen;
};

Counts count(const HostFiles& files, int cpu) { return {count_interrupts(files, cpu), stolen_ticks(files, cpu)}; }

// Time that the thread did not get although no other task had the core.
class Stolen {
 public:
  void ask(std::int64_t now_ns) {
    const std::int64_t cpu_ns = own_cpu_ns();
    const long switches = own_usage().ru_nivcsw;
    if (switches == switches_) sum_ns_ += std::max<std::int64_t>(0, (now_ns - now_ns_) - (cpu_ns - cpu_ns_));
    now_ns_ = now_ns;
    cpu_ns_ = cpu_ns;
    switches_ = switches;
  }
  // The core was lost within a question: the next one sets the start again.
  void forget() { switches_ = -1; }
  std::int64_t sum_ns() const { return sum_ns_; }

 private:
  std::int64_t now_ns_ = 0, cpu_ns_ = 0, sum_ns_ = 0;
  long switches_ = -1;  // the first question only sets the start
};

struct Scan {
  std::vector<Gap> gaps;  // as many as there is room for
  std::uint64_t count = 0;
  std::int64_t from_ns = 0, until_ns = 0, sum_ns = 0, longest_ns = 0, stolen_ns = 0;
  long switches = 0, minor_faults = 0;
};

Scan scan(double seconds) {
  Scan found;
  // Written now, so that the loop makes no page fault.
  found.gaps.assign(std::min(kMostGaps, static_cast<std::size_t>(std::ceil(seconds)) * kMostGapsPerS), Gap{1, 1});
  const RawClock clock = RawClock::calibrate();
  Stolen stolen;
  const rusage before = own_usage();
  found.from_ns = clock.now_ns();
  stolen.ask(found.from_ns);
  const std::int64_t end_ns = found.from_ns + static_cast<std::int64_t>(seconds * 1e9);
  std::int64_t last_ns = clock.now_ns();
  const auto note = [&](std::int64_t start_ns, std::int64_t length_ns) {
    if (found.count < found.gaps.size()) found.gaps[found.count] = {start_ns, length_ns};
    ++found.count;
    found.sum_ns += length_ns;
    found.longest_ns = std::max(found.longest_ns, length_ns);
  };
  while (last_ns < end_ns) {
    const std::int64_t now_ns = clock.now_ns();
    const std::int64_t gap_ns = now_ns - last_ns;
    if (gap_ns > kGapNs) {
      note(last_ns, gap_ns);
      if (gap_ns > kAskNs) stolen.ask(now_ns);
      last_ns = clock.now_ns();
      // At the end of a system call the core often goes to the other task: what is longer than the call was a gap, too.
      if (last_ns - now_ns > kAskNs) {
        note(now_ns, last_ns - now_ns);
        stolen.forget();
      }
    } else {
      last_ns = now_ns;
    }
  }
  found.until_ns = last_ns;
  stolen.ask(last_ns);
  const rusage after = own_usage();
  found.stolen_ns = stolen.sum_ns();
  found.switches = after.ru_nivcsw - before.ru_nivcsw;
  found.minor_faults = after.ru_minflt - before.ru_minflt;
  found.gaps.resize(std::min<std::size_t>(found.count, found.gaps.size()));
  return found;
}

std::optional<double> rate(const std::optional<std::uint64_t>& before, const std::optional<std::uint64_t>& after,
                           double seconds) {
  if (!before || !after || *after < *before) return std::nullopt;
  return static_cast<double>(*after - *before) / seconds;
}

Measured summarise(const Scan& found, const Counts& before, const Counts& after) {
  Measured seen;
  seen.seconds = 1e-9 * static_cast<double>(found.until_ns - found.from_ns);
  const double wall_ns = 1e9 * seen.seconds;
  seen.gaps_per_s = static_cast<double>(found.count) / seen.seconds;
  seen.gap_share = static_cast<double>(found.sum_ns) / wall_ns;
  seen.gap_max_us = 1e-3 * static_cast<double>(found.longest_ns);
  if (before.interrupts && after.interrupts) {
    seen.ticks_per_s = rate(before.interrupts->timer, after.interrupts->timer, seen.seconds);
    seen.core_interrupts_per_s = rate(before.interrupts->cores, after.interrupts->cores, seen.seconds);
    seen.device_interrupts_per_s =
        rate(before.interrupts->device_total(), after.interrupts->device_total(), seen.seconds);
  }
  seen.switches_per_s = static_cast<double>(found.switches) / seen.seconds;
  seen.minor_faults_per_s = static_cast<double>(found.minor_faults) / seen.seconds;
  seen.stolen_share = static_cast<double>(found.stolen_ns) / wall_ns;
  if (before.stolen && after.stolen) seen.stolen_s = 0.01 * static_cast<double>(*after.stolen - *before.stolen);
  seen.phase_share = phase_shares(found.gaps);
  seen.quietest_phase_us = quietest_phase_us(seen.phase_share);
  const bool all = found.count == found.gaps.size();  // else nothing is known of the time behind the last one kept
  seen.rates = rate_shares(found.gaps, found.from_ns, all ? found.until_ns : found.gaps.back().start_ns);
  return seen;
}

}  // namespace

Result<Measured> measure(const HostFiles& files, int cpu, double seconds) {
  Result<Measured> result = Error{"the measurement did not run"};
  std::thread([&] {
    if (const Result<> pinned = pin_this_thread(cpu); !pinned) {
      result = Error{pinned.message()};
      return;
    }
    setpriority(PRIO_PROCESS, 0, -20);  // of this thread, as the Spine asks for; refused without the right
    const Counts before = count(files, cpu);
    const Scan found = scan(seconds);
    const Counts after = count(files, cpu);
    result = summarise(found, before, after);
    result->cpu = cpu;
  }).join();
  return result;
}

}  // namespace lithe::host
