// SPDX-License-Identifier: Apache-2.0
// Items 8 to 11: the Spine's own thread, and what the kernel does to real-time threads.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <set>

#include "host/doctor/item.hpp"
#include "host/read/machine.hpp"

namespace lithe::host {
namespace {

constexpr const char* kOrdinary = "concerns real-time threads only; LITHE's Spine is SCHED_OTHER";
constexpr std::pair<int, int> kFairServerSince = {6, 12};

// Of a running Spine: whether one of its threads on this core is SCHED_FIFO or SCHED_RR. Nothing when unknown.
std::optional<bool> spins_realtime(const Subject& subject, Notes& notes) {
  for (const Task& each : subject.tasks.all) {
    if (!each.is_spine() || !each.is_realtime() || !each.may_run_on(subject.cpu)) continue;
    notes.add(fmt::format("/proc/{}/task/{}/stat", each.pid, each.tid), "{}: policy {}", each.name,
              each.policy == 1 ? "SCHED_FIFO" : "SCHED_RR");
    return true;
  }
  if (!subject.tasks.is_whole()) {
    notes.add(kAllTasks, subject.tasks.why_not_whole);
    return std::nullopt;
  }
  return false;
}

Finding check_spine_pinned(const Subject& subject, Notes& notes) {
  bool runs = false;
  std::set<int> pinned;  // processes
  for (const Task& each : subject.tasks.all) {
    if (!each.is_spine()) continue;
    runs = true;
    if (each.cpus != std::vector<int>{subject.cpu} || !pinned.insert(each.pid).second) continue;
    notes.add(fmt::format("/proc/{}/task/{}/status", each.pid, each.tid), "{}: Cpus_allowed_list {}", each.name,
              subject.cpu);
  }
  if (pinned.size() > 1) {
    return notes.say(State::fail, "{} Spines are pinned to core {}, and each delays the others: pids {}", pinned.size(),
                     subject.cpu, fmt::join(pinned, ", "));
  }
  if (!pinned.empty() && subject.tasks.is_whole())
    return notes.say(State::ok, "a thread of the running Spine is pinned to core {}", subject.cpu);
  notes.add(kAllTasks, subject.tasks.is_whole() ? fmt::format("{} threads", subject.tasks.all.size())
                                                : subject.tasks.why_not_whole);
  if (!subject.tasks.is_whole()) return notes.say(State::unknown, subject.tasks.why_not_whole);
  if (runs) return notes.say(State::fail, "no thread of the running Spine is pinned to core {}", subject.cpu);
  return notes.say(State::not_applicable, "no Spine runs; it pins itself when it starts");
}

Finding check_rt_throttling(const Subject& subject, Notes& notes) {
  const std::string path = "/proc/sys/kernel/sched_rt_runtime_us";
  const std::optional<long long> runtime_us = notes.number(path);
  if (!runtime_us) return notes.unread(path);
  if (*runtime_us == -1) return notes.say(State::ok, "real-time threads are not throttled");
  const std::optional<bool> realtime = spins_realtime(subject, notes);
  if (!realtime) return notes.say(State::unknown, "the scheduling of a running Spine cannot be read");
  if (!*realtime) return notes.say(State::not_applicable, kOrdinary);
  return notes.say(State::fail, "a real-time Spine loses the core after {} us of each second", *runtime_us);
}

Finding check_fair_server(const Subject& subject, Notes& notes) {
  const std::string path = fmt::format("/sys/kernel/debug/sched/fair_server/cpu{}/runtime", subject.cpu);
  const auto version = kernel_version(subject.files);
  notes.read("/proc/sys/kernel/osrelease");
  if (!version) return notes.unread("/proc/sys/kernel/osrelease");
  if (*version < kFairServerSince) return notes.say(State::not_applicable, "kernels before 6.12 have none");
  const std::optional<bool> realtime = spins_realtime(subject, notes);
  if (!realtime) return notes.say(State::unknown, "the scheduling of a running Spine cannot be read");
  const std::optional<long long> runtime_ns = notes.number(path);
  if (runtime_ns == 0) return notes.say(State::ok, "the fair server of this core is off");
  if (!*realtime) return notes.say(State::not_applicable, kOrdinary);
  if (!runtime_ns) return notes.unread(path);
  return notes.say(State::fail, "ordinary tasks get {} ms of each second from a real-time Spine",
                   *runtime_ns / 1'000'000);
}

Finding check_smt(const Subject& subject, Notes& notes) {
  const std::string path = fmt::format("/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list", subject.cpu);
  const std::vector<int> siblings = parse_cpu_list(notes.read(path).value);
  if (siblings == std::vector<int>{subject.cpu}) return notes.say(State::ok, "the core shares its units with no other");
  if (siblings.empty()) return notes.unread(path);
  return notes.say(State::warn, "cores {} are threads of one physical core", cpu_list(siblings));
}

constexpr Item kRealtimeItems[] = {
    {8, "spine_pinned", "The Spine is pinned to the core", "a Spine that moves loses its caches and meets other tasks",
     "[spine] cpu_spine = {cpu} in the robot file", kNow, check_spine_pinned},
    {9, "rt_throttling", "Real-time threads are not throttled",
     "a real-time thread that spins loses 50 ms of each second",
     "let the Spine be SCHED_OTHER, or sysctl kernel.sched_rt_runtime_us=-1", kNow, check_rt_throttling},
    {10, "fair_server", "The fair server is off",
     "since Linux 6.12 ordinary tasks get 50 ms of each second from a real-time thread, also without throttling",
     "let the Spine be SCHED_OTHER, or echo 0 > /sys/kernel/debug/sched/fair_server/cpu{cpu}/runtime", kNow,
     check_fair_server},
    {11, "smt", "No second thread on the same physical core",
     "a sibling shares the execution units and the first cache", "echo off > /sys/devices/system/cpu/smt/control", kNow,
     check_smt},
};

}  // namespace

std::span<const Item> realtime_items() { return kRealtimeItems; }

}  // namespace lithe::host
