// SPDX-License-Identifier: Apache-2.0
// What each item of the checklist says of each of six whole machines (host/test/machines_rig.hpp tells what they are),
// and that an item which is the same on all of them turns with what it reads.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "host/doctor/diagnosis.hpp"
#include "host/test/machines_rig.hpp"

namespace lithe::host {
namespace {

constexpr std::array kMachines = {put_desktop, put_pinned, put_partition, put_booted, put_pi, put_fifo};

// A letter for each of them: o ok, n not applicable, u unknown, w warn, f fail.
struct Row {
  std::string_view id, states;
};
constexpr std::array kRows = {
    Row{"domain_isolation", "ffooff"},
    Row{"isolated_partition", "wwonwn"},
    Row{"v1_shield", "nnnnnf"},
    Row{"user_tasks", "foooff"},
    Row{"kernel_threads", "woooww"},
    Row{"bound_kernel_threads", "uuuuuu"},
    Row{"workqueues", "wwooow"},
    Row{"spine_pinned", "nnnnno"},
    Row{"rt_throttling", "nnnnnf"},
    Row{"fair_server", "nnnnnf"},
    Row{"smt", "wwooow"},
    Row{"irq_affinity", "ffoouf"},
    Row{"irqbalance", "wwooow"},
    Row{"tickless", "wwwoww"},
    Row{"rcu_callbacks", "wwwoww"},
    Row{"release_phase", "uuuuuu"},
    Row{"timer_migration", "wwooow"},
    Row{"skew_tick", "wwwoww"},
    Row{"watchdogs", "wwooow"},
    Row{"vmstat", "wwooow"},
    Row{"periodic_work", "wwwwow"},
    Row{"core_interrupts", "uuuuuu"},
    Row{"tracing", "oooooo"},
    Row{"clocksource", "ffooof"},
    Row{"governor", "wwwoww"},
    Row{"turbo", "wwwonw"},
    Row{"idle_states", "wwwonw"},
    Row{"bus_power", "wwwwww"},
    Row{"jetson_mode", "nnnnnn"},
    Row{"memory_lock", "ffooof"},
    Row{"malloc", "nnnnnn"},
    Row{"memory_scans", "wwooow"},
    Row{"swap", "wwooow"},
    Row{"shared_memory", "oooooo"},
    Row{"cache_partition", "wwwwnn"},
    Row{"memory_limit", "ooooow"},
    Row{"mitigations", "nnnnnn"},
    Row{"page_sampling", "nnnnnn"},
    Row{"memory_balloon", "uuuuuu"},
};

char letter(State state) { return "onuwf"[static_cast<std::size_t>(state)]; }

State state_of(std::string_view id, const FakeRoot& root, std::optional<Measured> measured = std::nullopt) {
  const auto at = std::ranges::find(checklist(), id, &Item::id);
  EXPECT_NE(at, checklist().end()) << id;
  return at->check(read_subject(HostFiles(root.path()), kJudged, std::move(measured))).state;
}

TEST(Machines, EachItemSaysOfEachWhatItsFilesSay) {
  ASSERT_EQ(kRows.size(), checklist().size());
  std::array<std::string, kRows.size()> told;
  for (const auto put : kMachines) {
    const FakeRoot root;
    put(root);
    const Diagnosis diagnosis = diagnose(HostFiles(root.path()), kJudged);
    for (std::size_t i = 0; i < kRows.size(); ++i) told[i] += letter(diagnosis.findings[i].state);
  }
  for (std::size_t i = 0; i < kRows.size(); ++i) {
    EXPECT_EQ(kRows[i].id, checklist()[i].id);
    EXPECT_EQ(kRows[i].states, told[i]) << kRows[i].id;
  }
}

// Of a desktop with one more file, or another text in it.
struct Changed {
  std::string_view id;
  State before;
  const char *path, *text;
  State after;
};

TEST(Machines, WhatIsTheSameOnAllSixTurnsWithItsFile) {
  constexpr std::array kChanges = {
      Changed{"tracing", State::ok, "/sys/kernel/tracing/current_tracer", "function", State::warn},
      Changed{"tracing", State::ok, "/sys/kernel/tracing/set_event", "sched:sched_switch", State::warn},
      Changed{"tracing", State::ok, "/sys/kernel/tracing/instances/left/set_event", "sched:*", State::warn},
      Changed{"tracing", State::ok, "/sys/kernel/tracing/instances/left/current_tracer", "osnoise", State::warn},
      Changed{"tracing", State::ok, "/sys/kernel/tracing/instances/left/current_tracer", "nop", State::unknown},
      Changed{"shared_memory", State::ok, "/proc/self/mounts", "/dev/sda1 / ext4 rw 0 0", State::fail},
      Changed{"shared_memory", State::ok, "/proc/self/mounts",
              "tmpfs /dev/shm tmpfs rw 0 0\n/dev/sda1 /dev/shm ext4 rw 0 0", State::fail},
      Changed{"memory_limit", State::ok, "/sys/fs/cgroup/user.slice/memory.max", "1000000", State::warn},
  };
  for (const Changed& each : kChanges) {
    const FakeRoot root;
    put_desktop(root);
    EXPECT_EQ(state_of(each.id, root), each.before) << each.id;
    root.write(each.path, std::string(each.text) + "\n");
    EXPECT_EQ(state_of(each.id, root), each.after) << each.id << ": " << each.text;
  }
}

TEST(Machines, BusesStayAwakeOnlyWhenBothDo) {
  const FakeRoot root;
  put_desktop(root);
  EXPECT_EQ(state_of("bus_power", root), State::warn);
  root.write("/sys/module/pcie_aspm/parameters/policy", "default [performance] powersave\n");
  EXPECT_EQ(state_of("bus_power", root), State::warn);
  root.write("/sys/module/usbcore/parameters/autosuspend", "-1\n");
  EXPECT_EQ(state_of("bus_power", root), State::ok);
}

TEST(Machines, AJetsonHasItsPowerMode) {
  const FakeRoot root;
  put_pi(root);
  root.write("/proc/device-tree/model", "NVIDIA Jetson Orin Nano Developer Kit\n");
  EXPECT_EQ(state_of("jetson_mode", root), State::unknown);
  root.write("/var/lib/nvpmodel/status", "pmode:0003\n");
  EXPECT_EQ(state_of("jetson_mode", root), State::warn);
  root.write("/var/lib/nvpmodel/status", "pmode:0000\n");
  EXPECT_EQ(state_of("jetson_mode", root), State::ok);
}

TEST(Machines, SamplingOfPagesIsSeenByEachOfItsFiles) {
  const FakeRoot root;
  put_desktop(root);
  root.write("/sys/kernel/mm/damon/admin/kdamonds/nr_kdamonds", "2\n");
  EXPECT_EQ(state_of("page_sampling", root), State::unknown) << "two, of which nothing can be read";
  root.write("/sys/kernel/mm/damon/admin/kdamonds/0/state", "off\n");
  root.write("/sys/kernel/mm/damon/admin/kdamonds/1/state", "off\n");
  EXPECT_EQ(state_of("page_sampling", root), State::ok);
  root.write("/sys/module/damon_reclaim/parameters/enabled", "Y\n");
  EXPECT_EQ(state_of("page_sampling", root), State::warn);
  root.write("/sys/module/damon_reclaim/parameters/enabled", "N\n");
  root.write("/sys/kernel/mm/damon/admin/kdamonds/1/state", "on\n");
  EXPECT_EQ(state_of("page_sampling", root), State::warn);
}

TEST(Machines, ABalloonIsOneThatADeviceHas) {
  const FakeRoot root;
  put_desktop(root);
  root.write("/sys/bus/virtio/drivers/virtio_net/bind", "");
  EXPECT_EQ(state_of("memory_balloon", root), State::ok) << "no driver";
  root.write("/sys/bus/virtio/drivers/virtio_balloon/bind", "");
  EXPECT_EQ(state_of("memory_balloon", root), State::ok) << "no device";
  root.write("/sys/bus/virtio/drivers/virtio_balloon/virtio3/features", "0110000000\n");
  EXPECT_EQ(state_of("memory_balloon", root), State::warn);
}

TEST(Machines, WhatOnlyAMeasurementTellsTurnsWithIt) {
  const FakeRoot root;
  put_booted(root);
  Measured seen;
  seen.core_interrupts_per_s = 0.0;
  seen.phase_share.assign(20, 0.0);
  for (const char* id : {"bound_kernel_threads", "core_interrupts", "release_phase"})
    EXPECT_EQ(state_of(id, root, seen), State::ok) << id;
  seen.switches_per_s = 1000;
  seen.core_interrupts_per_s = 1000;
  seen.phase_share[10] = 1;  // 500 to 550 us, where a Spine begins by default
  for (const char* id : {"bound_kernel_threads", "core_interrupts", "release_phase"})
    EXPECT_EQ(state_of(id, root, seen), State::warn) << id;
}

}  // namespace
}  // namespace lithe::host
