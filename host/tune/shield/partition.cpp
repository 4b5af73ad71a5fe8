// SPDX-License-Identifier: Apache-2.0
#include "host/tune/shield/shield_plan.hpp"

#include <fmt/format.h>

#include <utility>

#include "host/read/machine.hpp"
#include "host/read/tasks.hpp"
#include "host/read/words.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/shield_group.hpp"

namespace lithe::host {
namespace {

constexpr std::pair<int, int> kKeepsMasksSince = {6, 2};  // then the kernel remembers which cores a task asked for

std::string in_group(const char* name) { return std::string(kShieldGroup) + "/" + name; }

Change part(ChangeKind kind, const std::string& path, const std::string& before, const std::string& after,
            const char* why) {
  const bool is_new = kind == ChangeKind::group || kind == ChangeKind::controller;
  return {.kind = kind,
          .item = kPartitionItem,
          .path = path,
          .was_absent = is_new,
          .before = before,
          .after = after,
          .why = why};
}

bool forgets_masks(const HostFiles& files) {
  const auto version = kernel_version(files);
  return !version || *version < kKeepsMasksSince;
}

// Tasks that somebody gave other cores than those that all others have.
std::vector<Task> pinned_tasks(const std::vector<int>& usual, const std::vector<int>& only) {
  std::vector<Task> pinned = read_tasks(HostFiles(), only).all;
  std::erase_if(pinned, [&](const Task& each) { return each.is_bound || each.cpus == usual; });
  return pinned;
}

Change of_task(const Task& task, const std::vector<int>& before, const std::vector<int>& after) {
  return {.kind = ChangeKind::affinity,
          .item = kPartitionItem,
          .path = task.path(),
          .before = cpu_list(before),
          .after = cpu_list(after),
          .why = task.name + " has cores of its own choice",
          .start_time_ticks = task.start_time_ticks};
}

// Of its groups, or of its tasks.
std::vector<Entry> entries_of(const Journal& journal, bool tasks) {
  std::vector<Entry> entries = journal.entries();
  std::erase_if(entries, [&](const Entry& each) {
    return each.change.item != kPartitionItem || (each.change.kind == ChangeKind::affinity) != tasks;
  });
  return entries;
}

// Written down before the kernel forgets it.
Result<> note_pinned(Journal& journal, const std::vector<Task>& pinned, const std::vector<int>& online) {
  for (const Task& task : pinned)
    if (const auto number = journal.begin(of_task(task, task.cpus, online)); !number) return number.error();
  return done();
}

// In the partition's time they keep what is left of their cores.
Result<> pin_again(Journal& journal, const Writer& writer, const std::vector<Task>& pinned,
                   const std::vector<int>& cores) {
  for (const Task& task : pinned) {
    const std::vector<int> rest = cores_without(task.cpus, cores);
    if (rest.empty()) continue;
    const Change change = of_task(task, task.cpus, rest);
    const auto number = journal.begin(change);
    if (!number) return number.error();
    const int error = writer.set(change, {.value = change.after});
    if (const Result<> noted = journal.finish(*number, error, change.after); !noted) return noted;
  }
  return done();
}

// Why another partition is in the way; empty: none is. It may be a robot's that runs.
std::string other_partition(const HostFiles& files, const std::vector<Change>& changes) {
  const std::string theirs = files.read(in_group("cpuset.cpus")).value;
  for (const Change& change : changes)
    if (change.path.ends_with("/cpuset.cpus") && !theirs.empty() &&
        parse_cpu_list(theirs) != parse_cpu_list(change.after))
      return fmt::format("there is one for cores {}, not {}: end it (sudo lithe tune revert) first", theirs,
                         change.after);
  return "";
}

std::string why_not_made(const HostFiles& files, const std::vector<Step>& steps) {
  for (const Step& step : steps)
    if (!step.well()) return step.change.path + ": " + step.why();
  return in_group("cpuset.cpus.partition") + " says " + partition_state(files);
}

}  // namespace

std::string partition_state(const HostFiles& files) { return files.read(in_group("cpuset.cpus.partition")).value; }

std::vector<Change> partition_plan(const HostFiles& files, const std::vector<int>& cores) {
  const std::string root = kGroupsRoot;
  if (cgroup2_folder(files) != root || !has_word(files.read(root + "/cgroup.controllers").value, "cpuset")) return {};
  const bool ours = parse_cpu_list(files.read(in_group("cpuset.cpus")).value) == cores;
  if (partition_state(files) == "isolated" && ours) return {};
  std::vector<Change> changes;
  if (!has_word(files.read(root + "/cgroup.subtree_control").value, "cpuset")) {
    changes.push_back(part(ChangeKind::controller, root + "/cgroup.subtree_control", "", "cpuset",
                           "groups below the root may have cores of their own"));
  }
  changes.push_back(part(ChangeKind::group, kShieldGroup, "", "", "a group for the robot's threads"));
  changes.push_back(
      part(ChangeKind::setting, in_group("cpuset.cpus"), "", cpu_list(cores), "it has the robot's cores"));
  changes.push_back(part(ChangeKind::setting, in_group("cpuset.cpus.partition"), "member", "isolated",
                         "no other task gets these cores, also if it asks for them"));
  // systemd turns a controller off at the root when no unit of its own needs it; the kernel refuses while a child uses
  // it.
  changes.push_back(part(ChangeKind::controller, in_group("cgroup.subtree_control"), "", "cpuset",
                         "keeps others from ending the partition without a word"));
  return changes;
}

Result<MadePartition> make_partition(Journal& journal, const Writer& writer, const std::vector<Change>& changes,
                                     const std::vector<int>& only) {
  const HostFiles files(writer.root());
  if (const std::string other = other_partition(files, changes); !other.empty()) return MadePartition{{}, other};
  const std::vector<int> online = online_cores(files);
  std::vector<Task> pinned;
  if (forgets_masks(files)) pinned = pinned_tasks(online, only);
  if (const Result<> noted = note_pinned(journal, pinned, online); !noted) return noted.error();
  MadePartition made;
  std::vector<int> cores;
  for (const Change& change : changes) {
    if (change.path.ends_with("/cpuset.cpus")) cores = parse_cpu_list(change.after);
    auto steps = apply(journal, writer, {change});
    if (!steps) return steps.error();
    made.steps.push_back(std::move(steps->front()));
    const bool last = &change == &changes.back();  // of use, but not needed
    if (!made.steps.back().well() && !last) break;
  }
  if (partition_state(files) == "isolated") {
    const Result<> kept = pin_again(journal, writer, pinned, cores);
    if (!kept) return kept.error();
    return made;
  }
  made.why_not = why_not_made(files, made.steps);
  const auto undone = unmake_partition(journal, writer, only);
  if (!undone) return undone.error();
  std::erase_if(made.steps, [](const Step& each) { return each.well(); });
  return made;
}

Result<std::vector<Step>> unmake_partition(Journal& journal, const Writer& writer, const std::vector<int>& only) {
  const std::vector<Entry> entries = entries_of(journal, false);
  std::vector<Task> pinned;
  if (!entries.empty() && forgets_masks(HostFiles(writer.root()))) {
    std::vector<int> usual = online_cores(HostFiles(writer.root()));
    for (const Entry& each : entries)
      if (each.change.path.ends_with("/cpuset.cpus")) usual = cores_without(usual, parse_cpu_list(each.change.after));
    pinned = pinned_tasks(usual, only);
  }
  auto steps = revert_entries(journal, writer, entries, true);
  if (!steps) return steps;
  for (const Task& task : pinned) (void)writer.set(of_task(task, {}, {}), {.value = cpu_list(task.cpus)});
  const auto chosen = revert_entries(journal, writer, entries_of(journal, true), true);
  return chosen ? steps : chosen.error();
}

}  // namespace lithe::host
