// SPDX-License-Identifier: Apache-2.0
// The floor and LITHE in blocks that alternate on one core and in one phase: `python -m bench.isolation` asks for them.
//
//   bench_isolation RECORDS_FILE
//
// Reads lines `VERB NUMBER`, appends a Record of each release to RECORDS_FILE, answers {"records": N, "offers": N}:
//   pairs N        N times 500 ms of a bare spin (the floor), of one that writes what a tick writes, and of LITHE
//   control N      N times 500 ms of LITHE with another busy thread on its core: the negative control
//   cyclictest S   cyclictest on the same core for S seconds
//   swaps 0|1      from now on, a law is offered every 20 ms, or none
#include <cstdio>
#include <iostream>
#include <string>
#include <utility>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/cyclictest.hpp"
#include "bench/rig/machine.hpp"
#include "bench/rig/spine_rig.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::bench {
namespace {

constexpr std::int64_t kBlockNs = 500 * kNsPerMs;

// bench/isolation/figures.py reads these bytes.
enum class Program : std::uint8_t { floor, lithe, control, cyclictest, writing };
struct Record {
  std::int64_t late_ns, stolen_ns, handoff_ns, release_ns, work_ns, page_ns;
  std::uint16_t switches, sleeps;
  Program program;
  bool missed;
  std::uint16_t told;  // what made it late: kPage, kOurs, or what a reader of the kernel's trace adds
};
constexpr std::uint16_t kPage = 6, kOurs = 7;  // 1 and the index in CAUSES there

// robots/arm.toml, with longer time-outs: a machine that stalls must not make the guard stop the arm in every block.
robot::RobotConfig patient_arm() {
  auto config = or_exit(robot::load_robot(LITHE_ROBOTS "/arm.toml"));
  config.spine.late_ticks_to_stop = 300;
  return config;
}

class Subject {
 public:
  Subject(Cores cores, bool transport_inline, std::FILE* file)
      : cores_(cores), file_(file), rig_(patient_arm(), cores, transport_inline) {}

  void serve(const std::string& verb, int number) {
    written_ = 0;
    if (verb == "pairs") pairs(number);
    if (verb == "control") control(number);
    if (verb == "cyclictest") cyclictest(number);
    if (verb == "swaps") rig_.swap_laws(number != 0);
    std::fflush(file_);
    answer();
  }
  void answer() const {
    std::printf("{\"records\": %zu, \"offers\": %llu}\n", written_, static_cast<unsigned long long>(rig_.offers()));
    std::fflush(stdout);
  }

 private:
  void write(Program program, const std::vector<Cycle>& cycles) {
    for (const Cycle& each : cycles) {
      const Record record{each.late_ns,
                          each.stolen_ns,
                          each.handoff_ns,
                          each.release_ns,
                          each.work_ns,
                          each.page_ns,
                          static_cast<std::uint16_t>(each.switches),
                          static_cast<std::uint16_t>(each.sleeps),
                          program,
                          each.missed,
                          each.paged ? kPage
                          : each.own ? kOurs
                                     : std::uint16_t{0}};
      written_ += std::fwrite(&record, sizeof record, 1, file_);
    }
  }
  void pairs(int count) {
    std::vector<Cycle> floor, writing, lithe;
    for (int i = 0; i < count; ++i) {
      rig_.run_bare_block(kBlockNs, floor);
      rig_.run_writing_block(kBlockNs, writing);
      rig_.run_block(kBlockNs, lithe);
    }
    write(Program::floor, floor);
    write(Program::writing, writing);
    write(Program::lithe, lithe);
  }
  void control(int blocks) {
    std::vector<Cycle> cycles;
    {
      const Competitor competitor(cores_.spine);
      for (int i = 0; i < blocks; ++i) rig_.run_block(kBlockNs, cycles);
    }
    write(Program::control, cycles);
  }
  void cyclictest(int seconds) {
    std::vector<std::int64_t> latency_ns;
    run_cyclictest(cores_.spine, seconds, latency_ns);
    std::vector<Cycle> cycles(latency_ns.size());
    for (std::size_t i = 0; i < cycles.size(); ++i) cycles[i].late_ns = latency_ns[i];
    write(Program::cyclictest, cycles);
  }

  Cores cores_;
  std::FILE* file_;
  SpineRig rig_;
  std::size_t written_ = 0;
};

}  // namespace
}  // namespace lithe::bench

int main(int argc, char** argv) {
  using namespace lithe::bench;
  std::FILE* file = argc == 2 ? std::fopen(argv[1], "wb") : nullptr;
  if (file == nullptr) give_up("usage: bench_isolation RECORDS_FILE, a file that can be written");
  const bool two_cores = lithe::machine_cores().automatic().size() < 3;  // asked before this thread is pinned
  Subject subject(become_a_spine(), two_cores, file);
  subject.answer();  // ready
  std::string verb;
  int number = 0;
  while (std::cin >> verb >> number) subject.serve(verb, number);
  std::fclose(file);
  return 0;
}
