// SPDX-License-Identifier: Apache-2.0
// Items 30 to 39: memory, and what takes it away.
#include <fmt/format.h>

#include <algorithm>
#include <cstdint>

#include "host/doctor/item.hpp"
#include "host/read/machine.hpp"
#include "host/read/words.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr const char* kKernelMemory = "/sys/kernel/mm";
constexpr long long kEnoughToLockBytes = 512LL << 20;
constexpr int kMayLock = 14;                    // CAP_IPC_LOCK
constexpr long long kAllUsers = 4294967295;     // a map of that many: no user namespace
constexpr long long kNoLimitBytes = 1LL << 60;  // cgroup v1 writes "no limit" as a number above this
constexpr std::size_t kMostFlagsBytes = std::size_t{2} << 20;
constexpr long long kRarelySwaps = 10;
constexpr long long kMostSamplers = 64;

// A running Spine tells whether its memory is locked. Nothing when none runs, or when that is not known.
std::optional<Finding> judge_running_spine(const Subject& subject, Notes& notes) {
  std::optional<Finding> found;
  for (const Task& each : subject.tasks.all) {
    if (!each.is_spine() || each.tid != each.pid) continue;
    const std::string path = fmt::format("/proc/{}/status", each.pid);
    const std::vector<std::string> locked = split(field_of(subject.files.read(path).value, "VmLck"));
    notes.add(path, locked.empty() ? "no VmLck" : "VmLck " + locked[0]);
    if (locked.empty()) return notes.say(State::unknown, "it cannot be read whether the Spine's memory is locked");
    if (locked[0] == "0") return notes.say(State::fail, "the running Spine's memory is not locked");
    found = notes.say(State::ok, "the running Spine's memory is locked");
  }
  return found;
}

// Whether this process may lock all memory whatever its limit: not with the capabilities of a user namespace.
bool may_lock_all(const Subject& subject, Notes& notes) {
  const std::string text = field_of(subject.files.read("/proc/self/status").value, "CapEff");
  const auto capabilities = leading_number<std::uint64_t>(text, 16);
  const std::vector<std::string> users = split(subject.files.read("/proc/self/uid_map").value);
  const bool all = users.size() == 3 && whole_number(users[2]) == kAllUsers;
  const bool may = all && (capabilities >> kMayLock & 1U) != 0;
  if (may) notes.add("/proc/self/status", "CapEff " + text + " has CAP_IPC_LOCK");
  return may;
}

// "unlimited", or the bytes that a process may raise its limit to; empty when unread.
std::string lock_limit(const Reading& limits) {
  const std::size_t at = limits.value.find("Max locked memory");
  if (at == std::string::npos) return "";
  const std::vector<std::string> words = split(limits.value.substr(at, limits.value.find('\n', at) - at));
  return words.size() < 5 ? "" : words[4];
}

State judge_number(Notes& notes, const std::string& path) {
  const std::optional<long long> value = notes.number(path);
  return !value ? State::unknown : *value == 0 ? State::ok : State::warn;
}

State judge_huge_pages(const Subject& subject, Notes& notes) {
  if (has_no(subject, kKernelMemory, "transparent_hugepage")) return State::not_applicable;
  const std::string mode = chosen(notes.read(fmt::format("{}/transparent_hugepage/enabled", kKernelMemory)).value);
  return mode.empty() ? State::unknown : mode == "always" ? State::warn : State::ok;
}

State judge_same_pages(const Subject& subject, Notes& notes) {
  if (has_no(subject, kKernelMemory, "ksm")) return State::not_applicable;
  const std::optional<long long> run = notes.number(fmt::format("{}/ksm/run", kKernelMemory));
  return !run ? State::unknown : *run == 1 ? State::warn : State::ok;
}

State judge_numa(const Subject& subject, Notes& notes) {
  if (has_no(subject, "/sys/devices/system", "node")) return State::not_applicable;
  if (notes.read("/sys/devices/system/node/online").value == "0") return State::not_applicable;
  return judge_number(notes, "/proc/sys/kernel/numa_balancing");
}

bool is_v1_limit(const Reading& limit) { return whole_number(limit.value).value_or(0) > kNoLimitBytes; }

// One level of the groups of cgroup v2: `max` is no limit. The root group has no such file, nor has a group whose
// controllers are without `memory`.
State judge_group(Notes& notes, const HostFiles& files, const std::string& folder) {
  const Reading controllers = files.read(folder + "/cgroup.controllers");
  if (controllers.known() && !has_word(controllers.value, "memory")) {
    notes.add(controllers.path, controllers.value.empty() ? "(none)" : controllers.value);
    return State::ok;
  }
  State state = State::ok;
  for (const char* name : {"/memory.high", "/memory.max"}) {
    const Reading limit = files.read(folder + name);
    if (limit.is_absent() && files.read(folder + "/cgroup.events").is_absent()) continue;
    notes.add(folder + name, shown(limit));
    state = worst({state, limit.value == "max" ? State::ok : limit.known() ? State::warn : State::unknown});
  }
  return state;
}

Finding check_memory_lock(const Subject& subject, Notes& notes) {
  const std::string limits_path = "/proc/self/limits";
  if (const auto running = judge_running_spine(subject, notes)) return *running;
  if (!subject.tasks.is_whole()) return notes.say(State::unknown, subject.tasks.why_not_whole);
  if (may_lock_all(subject, notes)) return notes.say(State::ok, "a Spine that is started here may lock its memory");
  const std::string limit = lock_limit(subject.files.read(limits_path));
  notes.add(limits_path, limit.empty() ? "no 'Max locked memory'" : "Max locked memory " + limit);
  if (limit.empty()) return notes.unread(limits_path);
  if (limit == "unlimited" || whole_number(limit).value_or(0) >= kEnoughToLockBytes)
    return notes.say(State::ok, "a Spine that is started here may lock its memory");
  return notes.say(State::fail, "a Spine that is started here may lock {} bytes only", limit);
}

Finding check_malloc(const Subject&, Notes& notes) {
  notes.add("lithe-spine", "mallopt: no trimming, no mmap, one arena; no allocation in the tick");
  return notes.say(State::not_applicable, "the Spine sets this itself, for its own process");
}

Finding check_memory_scans(const Subject& subject, Notes& notes) {
  const State huge = judge_huge_pages(subject, notes), same = judge_same_pages(subject, notes);
  const State numa = judge_numa(subject, notes);
  const State compaction = judge_number(notes, "/proc/sys/vm/compaction_proactiveness");
  const State state = worst({huge, same, numa, compaction});
  if (state == State::unknown) return notes.say(state, "not all of these settings can be read");
  if (state != State::warn) return notes.say(state, "the kernel does not move or scan memory by itself");
  std::string words;
  const std::pair<State, const char*> parts[] = {{huge, "makes huge pages of all memory"},
                                                 {same, "merges equal pages"},
                                                 {numa, "moves memory between nodes"},
                                                 {compaction, "compacts memory in advance"}};
  for (const auto& [part, what] : parts)
    if (part == State::warn) words += std::string(words.empty() ? "the kernel " : ", ") + what;
  return notes.say(state, words);
}

Finding check_swap(const Subject&, Notes& notes) {
  const std::string path = "/proc/swaps";
  const Reading swaps = notes.read(path);
  if (!swaps.known() || !swaps.value.starts_with("Filename")) return notes.unread(path);
  if (swaps.value.find('\n') == std::string::npos) return notes.say(State::ok, "there is no swap");
  const std::optional<long long> swappiness = notes.number("/proc/sys/vm/swappiness");
  if (!swappiness) return notes.unread("/proc/sys/vm/swappiness");
  return notes.say(*swappiness <= kRarelySwaps ? State::ok : State::warn, "swap is on, swappiness {}", *swappiness);
}

Finding check_shared_memory(const Subject& subject, Notes& notes) {
  const std::string path = "/proc/self/mounts";
  const Reading mounts = subject.files.read(path);
  std::string kind;
  for (const std::string_view line : lines_in(mounts.value)) {
    const std::vector<std::string> words = split(line);
    if (words.size() > 2 && words[1] == "/dev/shm") kind = words[2];  // the last one is on top
  }
  notes.add(path, mounts.known() ? (kind.empty() ? "no /dev/shm" : "/dev/shm " + kind) : shown(mounts));
  if (!mounts.known()) return notes.unread(path);
  if (kind == "tmpfs") return notes.say(State::ok, "shared memory is in memory (tmpfs)");
  return notes.say(State::fail, "/dev/shm is not a tmpfs: shared memory would be a file on a disk");
}

Finding check_cache_partition(const Subject& subject, Notes& notes) {
  const std::string folder = "/sys/fs/resctrl";
  const BoardKind board = board_of(subject.files);
  const std::string flags = field_of(subject.files.read("/proc/cpuinfo", kMostFlagsBytes).value, "flags");
  if (board == BoardKind::raspberry_pi || board == BoardKind::jetson) {
    notes.read("/proc/device-tree/model");
    return notes.say(State::not_applicable, "this board cannot partition its caches");
  }
  if (board != BoardKind::x86 || flags.empty())
    return notes.say(State::unknown, "it is not known what this processor can");
  const bool can = has_word(flags, "cat_l3") || has_word(flags, "cat_l2") || has_word(flags, "mba");
  notes.add("/proc/cpuinfo", can ? "flag cat_l3, cat_l2 or mba" : "no flag cat_l3, cat_l2, mba");
  if (!can) return notes.say(State::not_applicable, "this processor cannot partition its caches");
  for (const std::string& each : subject.files.list(folder)) {
    const std::string path = fmt::format("{}/{}/cpus_list", folder, each);
    const Reading cpus = subject.files.read(path);
    if (!contains(parse_cpu_list(cpus.value), subject.cpu)) continue;
    notes.add(path, cpus.value);
    return notes.say(State::ok, "group {} has a part of the cache for core {}", each, subject.cpu);
  }
  notes.add(folder, "no group has the core");
  return notes.say(State::warn, "other cores may push the Spine's data out of the shared cache");
}

Finding check_memory_limit(const Subject& subject, Notes& notes) {
  const std::string path = "/proc/self/cgroup";
  const Reading groups = notes.read(path);
  State state = State::unknown;
  for (const std::string_view line : lines_in(groups.value)) {
    const std::size_t v1 = line.find(":memory:");
    if (v1 != std::string_view::npos) {
      state = State::ok;
      std::string group(line.substr(v1 + 8));
      if (group == "/") group.clear();
      for (;; group.resize(group.rfind('/'))) {
        const Reading limit = notes.read("/sys/fs/cgroup/memory" + group + "/memory.limit_in_bytes");
        state = worst({state, !limit.known() ? State::unknown : is_v1_limit(limit) ? State::ok : State::warn});
        if (!group.starts_with('/')) break;
      }
      break;
    }
    if (!line.starts_with("0::/")) continue;
    state = State::ok;
    for (std::string group(line.substr(3)); group.size() > 1; group.resize(group.rfind('/')))
      state = worst({state, judge_group(notes, subject.files, "/sys/fs/cgroup" + group)});
    state = worst({state, judge_group(notes, subject.files, "/sys/fs/cgroup")});
  }
  if (state == State::unknown) return notes.say(state, "it cannot be read whether the group's memory is limited");
  return notes.say(state, state == State::ok ? "no limit of memory for what is started here"
                                             : "the memory of what is started here is limited");
}

Finding check_mitigations(const Subject&, Notes& notes) {
  notes.read("/proc/sys/kernel/randomize_va_space");
  return notes.say(State::not_applicable, "no effect once the Spine runs: leave it on");
}

// DAMON clears the mark "was accessed" of pages to see which are in use. The next access to such a page costs about
// 100 us in a virtual machine with shadow paging, also when the page is locked.
Finding check_page_sampling(const Subject& subject, Notes& notes) {
  const std::string folder = fmt::format("{}/damon/admin/kdamonds", kKernelMemory);
  if (has_no(subject, kKernelMemory, "damon"))
    return notes.say(State::not_applicable, "this kernel cannot sample which pages are in use");
  const std::optional<long long> count = notes.number(folder + "/nr_kdamonds");
  if (!count) return notes.unread(folder + "/nr_kdamonds");
  State state = State::ok;
  for (long long i = 0; i < std::min(*count, kMostSamplers); ++i) {
    const std::string is = notes.read(fmt::format("{}/{}/state", folder, i)).value;
    state = worst({state, is == "off" ? State::ok : is == "on" ? State::warn : State::unknown});
  }
  for (const char* module : {"damon_reclaim", "damon_lru_sort"})
    if (subject.files.read(fmt::format("/sys/module/{}/parameters/enabled", module)).value == "Y") {
      notes.read(fmt::format("/sys/module/{}/parameters/enabled", module));
      state = State::warn;
    }
  if (state == State::unknown) return notes.say(state, "it cannot be read whether the kernel samples memory");
  return notes.say(state, state == State::ok ? "the kernel does not sample which pages are in use"
                                             : "the kernel samples which pages are in use (DAMON)");
}

Finding check_memory_balloon(const Subject& subject, Notes& notes) {
  constexpr std::size_t kReporting = 5;  // VIRTIO_BALLOON_F_REPORTING
  const std::string drivers = "/sys/bus/virtio/drivers", driver = drivers + "/virtio_balloon";
  if (has_no(subject, "/sys/bus", "virtio"))
    return notes.say(State::not_applicable, "this machine has no virtio devices");
  if (has_no(subject, drivers, "virtio_balloon")) return notes.say(State::ok, "no driver gives memory to a hypervisor");
  if (!subject.files.is_folder(driver)) return notes.say(State::unknown, "{} cannot be read", driver);
  for (const std::string& device : subject.files.list(driver)) {
    if (!device.starts_with("virtio")) continue;
    const std::string features = notes.read(fmt::format("{}/{}/features", driver, device)).value;
    const bool reports = features.size() > kReporting && features[kReporting] == '1';
    return notes.say(State::warn, "the hypervisor may take memory back ({}{})", device,
                     reports ? ", which also gives it every free page" : "");
  }
  notes.add(driver, "no device");
  return notes.say(State::ok, "no device gives memory to a hypervisor");
}

constexpr Item kMemoryItems[] = {
    {30, "memory_lock", "The Spine's memory is locked", "else a tick can wait for a page: microseconds, or a disk",
     "LimitMEMLOCK=infinity in the unit, or '@lithe - memlock unlimited' in /etc/security/limits.d (lithe tune apply)",
     kNow, check_memory_lock},
    {31, "malloc", "malloc keeps its memory", "trimming and mapping change the page tables of all threads",
     "nothing to do", kNow, check_malloc},
    {32, "memory_scans", "The kernel does not scan or move memory",
     "huge pages, page merging, NUMA balancing and compaction interrupt every core that shares the memory",
     "echo madvise > /sys/kernel/mm/transparent_hugepage/enabled; echo 0 > /sys/kernel/mm/ksm/run; sysctl "
     "kernel.numa_balancing=0 vm.compaction_proactiveness=0",
     kNow, check_memory_scans},
    {33, "swap", "No swap, or hardly used", "the Brain waits for a disk in the middle of a plan",
     "swapoff -a, or sysctl vm.swappiness=10", kNow, check_swap},
    {34, "shared_memory", "Shared memory is memory", "Spine and Brain meet in /dev/shm",
     "mount -t tmpfs tmpfs /dev/shm", kNow, check_shared_memory},
    {35, "cache_partition", "The Spine has a part of the cache",
     "the Brain's data pushes the Spine's out; a small law stays in the first cache anyway",
     "mount -t resctrl resctrl /sys/fs/resctrl; a group with core {cpu} and its own schemata", kNow,
     check_cache_partition},
    {36, "memory_limit", "No memory limit for the robot's group",
     "at a limit the kernel takes memory back from the group, in the middle of what it does",
     "systemd: no MemoryHigh= and no MemoryMax= for the unit of lithe run", kNow, check_memory_limit},
    {37, "mitigations", "Address randomisation and mitigations",
     "they cost time at the start and at system calls; the tick makes none", "leave them on", kNow, check_mitigations},
    {38, "page_sampling", "The kernel does not sample which pages are in use",
     "the next access to a sampled page can take 100 us, also in locked memory",
     "echo off > /sys/kernel/mm/damon/admin/kdamonds/0/state, for each folder there that is on", kNow,
     check_page_sampling},
    {39, "memory_balloon", "No hypervisor takes memory back",
     "a page that was given back is missing at the next access, and the hypervisor then works on the Spine's core",
     "give the virtual machine no balloon (libvirt: <memballoon model='none'/>)", kNow, check_memory_balloon},
};

}  // namespace

std::span<const Item> memory_items() { return kMemoryItems; }

}  // namespace lithe::host
