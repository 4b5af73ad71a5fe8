// SPDX-License-Identifier: Apache-2.0
// One-way latency of a Channel between two cores, beside what the hardware can do and what other transports do.
//
// Every kind of link gets a short block in every round, so that whatever the machine does happens to all of them.
// The latency is half of a round trip. The control asks and answers on one core, where no poll can see an answer
// before the scheduler has changed threads: a bench that calls that fast is blind.
#include <algorithm>
#include <atomic>
#include <string>
#include <vector>

#include "bench/channel_links.hpp"
#include "bench/machine.hpp"
#include "bench/samples.hpp"
#include "spine/core/time.hpp"

namespace lithe::bench {
namespace {

constexpr int kRounds = 50;
constexpr std::int64_t kBlockNs = 60 * kNsPerMs;
constexpr int kWarmUp = 200;            // exchanges at the start of a block that are not counted
constexpr double kControlAtLeast = 20;  // the control's ratio must be at least this bad

// Exchanges messages for `block_ns` and appends half of each round trip.
void run_block(Link& link, Cores cores, std::int64_t block_ns, int warm_up, std::vector<std::int64_t>& latency_ns) {
  static std::atomic<std::uint64_t> first_sequence{1};  // never the same sequence twice, whatever is left in the link
  const std::uint64_t first = first_sequence.fetch_add(std::uint64_t{1} << 32);
  std::atomic<std::uint64_t> last{0};
  std::thread answering = on_core(cores.partner, [&] {
    for (std::uint64_t sequence = first; last.load(std::memory_order_relaxed) != sequence; ++sequence) {
      while (!link.arrived(1, sequence)) {
        if (last.load(std::memory_order_relaxed) == sequence) return;
      }
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

int run() {
  const Cores cores = pick_cores();
  std::vector<std::unique_ptr<Link>> links;
  links.push_back(make_cache_line_link());
  links.push_back(make_channel_56_link());
  links.push_back(make_channel_256_link());
  links.push_back(make_one_word_link());
  links.push_back(make_unix_datagram_link());
  links.push_back(make_zeromq_link());
  std::vector<std::vector<std::int64_t>> latency_ns(links.size());
  std::vector<std::vector<std::int64_t>> ratio_pm(
      links.size());  // of each round's medians, per mille of the cache line
  for (int round = 0; round < kRounds; ++round) {
    std::int64_t floor_ns = 1;
    for (std::size_t kind = 0; kind < links.size(); ++kind) {
      std::vector<std::int64_t> block_ns;
      run_block(*links[kind], cores, kBlockNs, kWarmUp, block_ns);
      const std::int64_t median_ns = quantile_ns(block_ns, 0.5);
      if (kind == 0) floor_ns = std::max<std::int64_t>(median_ns, 1);
      ratio_pm[kind].push_back(1000 * median_ns / floor_ns);
      latency_ns[kind].insert(latency_ns[kind].end(), block_ns.begin(), block_ns.end());
    }
  }
  std::vector<std::int64_t> control_ns;
  run_block(*links[1], {cores.spine, cores.spine}, 500 * kNsPerMs, 0, control_ns);

  JsonLine line;
  for (std::size_t kind = 0; kind < links.size(); ++kind) {
    const std::string name = links[kind]->name();
    line.quantiles(name, latency_ns[kind]);
    line.number(name + "_over_pingpong", static_cast<double>(quantile_ns(ratio_pm[kind], 0.5)) / 1e3);
  }
  const double floor_ns = static_cast<double>(std::max<std::int64_t>(quantile_ns(latency_ns[0], 0.5), 1));
  const double control = static_cast<double>(quantile_ns(control_ns, 0.5)) / floor_ns;
  line.number("control_same_core_over_pingpong", control);
  line.flag("control_failed_as_it_must", control >= kControlAtLeast);
  line.number("spine_cpu", cores.spine).number("partner_cpu", cores.partner);
  line.print();
  return 0;
}

}  // namespace
}  // namespace lithe::bench

int main() { return lithe::bench::run(); }
