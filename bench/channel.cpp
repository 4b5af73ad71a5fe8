// SPDX-License-Identifier: Apache-2.0
// One-way latency of a Channel between two cores, compared with the hardware's limit and with other transports.
//
// Every kind of link gets a short block in every round, so that the machine disturbs all of them in the same way.
// The latency is half of a round trip. The negative control asks and answers on one core, where no poll can see an
// answer before the scheduler has changed threads; its result must be bad.
#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "bench/channel_links.hpp"
#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "spine/core/time.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::bench {
namespace {

constexpr int kRounds = 50;
constexpr std::int64_t kBlockNs = 60 * kNsPerMs;
constexpr int kWarmUp = 200;            // exchanges at the start of a block that are not counted
constexpr double kControlAtLeast = 20;  // the ratio of the control must be at least this

// Exchanges messages for `block_ns` and appends half of each round trip.
void run_block(Link& link, Cores cores, std::int64_t block_ns, int warm_up, std::vector<std::int64_t>& latency_ns) {
  static std::atomic<std::uint64_t> first_sequence{
      1};  // never the same sequence twice: old messages may be in the link
  const std::uint64_t first = first_sequence.fetch_add(std::uint64_t{1} << 32);
  std::atomic<std::uint64_t> last{0};
  std::thread answering = on_core(cores.partner, [&] {
    for (std::uint64_t sequence = first; last.load(std::memory_order_relaxed) != sequence; ++sequence) {
      while (!link.arrived(1, sequence))
        if (last.load(std::memory_order_relaxed) == sequence) return;
      link.send(1, sequence);
    }
  });
  std::thread asking = on_core(cores.spine, [&] {
    const RawClock clock = RawClock::calibrate(2 * kNsPerMs);
    std::uint64_t sequence = first;
    const std::int64_t end_ns = clock.now_ns() + block_ns;
    for (std::int64_t now_ns = 0; now_ns < end_ns; ++sequence) {
      const std::int64_t sent_ns = clock.now_ns();
      link.send(0, sequence);
      while (!link.arrived(0, sequence)) spin_pause();
      now_ns = clock.now_ns();
      if (sequence - first >= static_cast<std::uint64_t>(warm_up)) latency_ns.push_back((now_ns - sent_ns) / 2);
    }
    last.store(sequence, std::memory_order_relaxed);
  });
  asking.join();
  answering.join();
}

struct Subject {
  std::unique_ptr<Link> link;
  std::vector<std::int64_t> latency_ns;
  std::vector<std::int64_t> median_ns;  // of each round
};

std::vector<Subject> all_links() {
  std::vector<Subject> subjects;
  for (const auto make : {make_cache_line_link, make_one_word_link, make_channel_56_link, make_channel_256_link,
                          make_raw_plan_link, make_channel_plan_link, make_unix_datagram_link, make_zeromq_link}) {
    subjects.push_back({make(), {}, {}});
  }
  return subjects;
}

const Subject& named(const std::vector<Subject>& subjects, const std::string& name) {
  return *std::find_if(subjects.begin(), subjects.end(),
                       [&](const Subject& each) { return each.link->name() == name; });
}

double ratio(const Subject& over, const Subject& under) { return middle_ratio(over.median_ns, under.median_ns); }

// The interquartile range of the rounds, as a share of the median. Above a quarter the ratio must not be quoted.
double spread(const std::vector<std::int64_t>& ratios_pm) {
  return static_cast<double>(quantile_ns(ratios_pm, 0.75) - quantile_ns(ratios_pm, 0.25)) /
         static_cast<double>(std::max<std::int64_t>(quantile_ns(ratios_pm, 0.5), 1));
}

void report(const std::vector<Subject>& subjects, const std::vector<std::int64_t>& control_ns, Cores cores) {
  const Subject& floor = named(subjects, "cache_line");
  const Subject& channel = named(subjects, "channel_56");
  JsonLine line;
  for (const Subject& subject : subjects) {
    const std::string name = subject.link->name();
    line.quantiles(name, subject.latency_ns).number(name + "_over_pingpong", ratio(subject, floor));
  }
  const double floor_ns = static_cast<double>(std::max<std::int64_t>(quantile_ns(floor.latency_ns, 0.5), 1));
  const double control = static_cast<double>(quantile_ns(control_ns, 0.5)) / floor_ns;
  line.number("channel_latency_over_pingpong", ratio(channel, floor))
      .number("channel_56_over_one_word", ratio(channel, named(subjects, "one_word")))
      .number("channel_plan_over_raw", ratio(named(subjects, "channel_plan"), named(subjects, "raw_plan")))
      .number("channel_round_spread", spread(ratios_pm(channel.median_ns, floor.median_ns)))
      .number("plan_bytes", static_cast<double>(sizeof(wire::Plan)))
      .number("control_same_core_over_pingpong", control)
      .flag("channel_control_failed_as_it_must", control >= kControlAtLeast)
      .number("spine_cpu", cores.spine)
      .number("partner_cpu", cores.partner)
      .print();
}

int run() {
  const Cores cores = pick_cores();
  std::vector<Subject> subjects = all_links();
  for (int round = 0; round < kRounds; ++round) {
    for (Subject& subject : subjects) {
      std::vector<std::int64_t> block_ns;
      run_block(*subject.link, cores, kBlockNs, kWarmUp, block_ns);
      subject.median_ns.push_back(quantile_ns(block_ns, 0.5));
      subject.latency_ns.insert(subject.latency_ns.end(), block_ns.begin(), block_ns.end());
    }
  }
  std::vector<std::int64_t> control_ns;
  run_block(*named(subjects, "channel_56").link, {cores.spine, cores.spine}, 500 * kNsPerMs, 0, control_ns);
  report(subjects, control_ns, cores);
  return 0;
}

}  // namespace
}  // namespace lithe::bench

int main() { return lithe::bench::run(); }
