// SPDX-License-Identifier: Apache-2.0
#include "host/tune/shield/shield.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cerrno>
#include <map>
#include <set>
#include <utility>

#include "host/read/tasks.hpp"
#include "host/tune/lasting.hpp"
#include "host/tune/shield/shield_plan.hpp"
#include "spine/core/host/child.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/realtime.hpp"

namespace lithe::host {
namespace {

constexpr int kMostRounds = 8;  // a task may start while others are moved
constexpr const char* kGroups = "cpuset";

constexpr const char* kNoRight =
    "a shield moves the tasks of all users, which needs root: start with sudo, or leave out --shield";

using TaskKey = std::pair<std::string, std::uint64_t>;

// What the moves of a journal did: from which mask to which.
struct Moves {
  std::map<std::string, std::string> back;  // narrow mask -> the widest one before it
  std::set<TaskKey> tasks;
  std::int64_t since_ticks = 0;
};

Moves moves_in(const std::vector<Entry>& entries) {
  Moves moves;
  for (const Entry& entry : entries) {
    const Change& change = entry.change;
    if (change.item != kTaskItem) continue;
    moves.since_ticks = moves.tasks.empty() ? entry.at_ticks : std::min(moves.since_ticks, entry.at_ticks);
    moves.tasks.emplace(change.path, change.start_time_ticks);
    // What the kernel made of it: it leaves out cores that are off.
    std::string& widest = moves.back[entry.ours.empty() ? change.after : entry.ours.back()];
    if (parse_cpu_list(change.before).size() > parse_cpu_list(widest).size()) widest = change.before;
  }
  return moves;
}

// A process with a thread on a shielded core alone is a robot's: its other threads chose their cores themselves.
std::set<int> robots_among(const std::vector<Task>& tasks, const Moves& moves) {
  std::set<int> robots;
  for (const Task& task : tasks) {
    for (const auto& [narrow, wide] : moves.back) {
      const std::vector<int> shielded = cores_without(parse_cpu_list(wide), parse_cpu_list(narrow));
      if (cores_without(task.cpus, shielded).empty()) robots.insert(task.pid);
    }
  }
  return robots;
}

// They pin themselves beside their Spine.
bool is_of_lithe(const Task& task) {
  return task.is_spine() || task.name == "lithe" || task.name == "lawd" || task.name == "lithe-trial";
}

// Tasks that started while the shield was up inherited the narrow mask of their parents; kernel threads have no
// parents.
std::vector<std::string> widen_the_born(const Writer& writer, const Moves& moves, const std::vector<int>& only) {
  if (moves.tasks.empty()) return {};
  const std::vector<Task> tasks = read_tasks(HostFiles(), only).all;
  const std::set<int> robots = robots_among(tasks, moves);
  std::vector<std::string> widened;
  for (const Task& task : tasks) {
    const auto wide = moves.back.find(cpu_list(task.cpus));
    const bool young = static_cast<std::int64_t>(task.start_time_ticks) >= moves.since_ticks;
    const bool known = moves.tasks.contains({task.path(), task.start_time_ticks});
    const bool chose = is_of_lithe(task) || robots.contains(task.pid);
    if (wide == moves.back.end() || !young || known || chose || task.is_bound || task.is_kernel) continue;
    const Change change{.kind = ChangeKind::affinity, .path = task.path(), .start_time_ticks = task.start_time_ticks};
    if (writer.set(change, {.value = wide->second}) == 0) widened.push_back(fmt::format("{} {}", task.name, task.tid));
  }
  return widened;
}

// Whether a thread of a child gets the core, as a thread of the Spine will ask for it; empty: it does.
std::string why_not_joined(int core) {
  const auto ask = [core](int out) {
    const Result<> pinned = pin_this_thread(core);
    if (!pinned) (void)write_all(out, pinned.message());
    return pinned ? 0 : 1;
  };
  const ChildEnd end = run_forked(ask, {.wall_ms = 5000, .output_bytes = 1000});
  if (end.started && end.signal == 0 && end.exit_code == 0) return "";
  return "a thread cannot join it: " + (end.output.empty() ? "it ended early" : end.output);
}

void count(const std::vector<Step>& steps, Lowered& undone) {
  for (const Step& step : steps) {
    undone.count += step.outcome == Outcome::done ? 1 : 0;
    if (step.outcome == Outcome::refused) undone.failed.push_back(step.change.path + ": " + step.why());
  }
}

Result<Lowered> undo_all(Journal& journal, const Writer& writer, const std::vector<int>& only) {
  const Moves moves = moves_in(journal.entries());
  const bool isolated = partition_state(HostFiles(writer.root())) == "isolated";
  const auto partition = unmake_partition(journal, writer, only);
  if (!partition) return partition.error();
  Lowered undone;
  const auto steps = revert_entries(journal, writer, journal.entries(), true);
  if (!steps) return steps.error();
  count(*partition, undone);
  undone.failed.clear();  // they are tried a second time
  count(*steps, undone);
  // Under a partition no task had to be moved, so none inherited it; unless the kernel ended it.
  if (partition->empty() || !isolated) undone.born = widen_the_born(writer, moves, only);
  undone.count += undone.born.size();
  return undone;
}

}  // namespace

Result<Shield> Shield::raise(const ShieldOptions& options) {
  const HostFiles files(options.root);
  auto journal = Journal::open(options.journal, boot_id(), true, options.hook);
  if (!journal) return Error{journal.message() + "; " + kNoRight};
  Shield shield(std::move(*journal), options);
  if (const auto left = undo_all(shield.journal_, shield.writer_, options.only); !left) return left.error();
  const ShieldPlan plan = options.machine ? shield_plan(files, options.cores) : ShieldPlan{};
  shield.facts_ = {.mechanism = plan.mechanism, .cores = options.cores, .notes = plan.notes};
  const auto in_order = [&](Result<> part) {
    if (part) return true;
    const auto lowered = shield.lower();
    if (!lowered) part = Error{part.message() + "; " + lowered.message()};
    return false;
  };
  if (HostFiles().read("/proc/2/comm").value != "kthreadd") {
    shield.facts_.notes.push_back(
        "only the tasks of this container were moved: those of its host may still run on the robot's core");
  }
  shield.moves_ = plan.mechanism > Mechanism::cpuset2;
  Result<> part = shield.make_partition(plan);
  if (!in_order(part)) return part.error();
  if (shield.moves_) part = shield.move_tasks();
  if (!in_order(part)) return part.error();
  if (options.machine) {
    if (part = shield.change_settings(); !in_order(part)) return part.error();
    if (!shield.partition_) part = shield.take_out_of_balancing(plan);
    if (!in_order(part)) return part.error();
  }
  return shield;
}

Result<Lowered> Shield::lower_left_over(const ShieldOptions& left, bool forget) {
  auto journal = Journal::open(left.journal, boot_id(), false, left.hook);
  if (!journal) return journal.error();
  auto undone = undo_all(*journal, Writer(left.root, left.hook), left.only);
  if (undone) undone->unreadable = journal->unreadable_lines();
  if (undone) journal->remove(forget);
  return undone;
}

Shield::~Shield() { (void)lower(); }

// Falls through to the next mechanism, and says so.
Result<> Shield::make_partition(const ShieldPlan& plan) {
  if (plan.partition.empty() || !options_.partition) return done();
  const auto made = host::make_partition(journal_, writer_, plan.partition, options_.only);
  if (!made) return made.error();
  partition_ = made->why_not.empty();
  std::string why_not = made->why_not;
  if (partition_ && options_.root.empty()) why_not = why_not_joined(options_.cores.front());
  if (partition_ && !why_not.empty()) {
    partition_ = false;
    if (const auto undone = unmake_partition(journal_, writer_, options_.only); !undone) return undone.error();
  }
  if (partition_) facts_.mechanism = Mechanism::cpuset2;
  if (!partition_) facts_.notes.push_back("no partition of cgroup v2: " + why_not);
  return done();
}

Result<std::string> Shield::keep_up() {
  if (!up_) return std::string();
  const HostFiles files(options_.root);
  std::string state = partition_ ? partition_state(files) : "isolated";
  // One that was there before, as of `lithe tune apply --partition`.
  const bool found = facts_.mechanism == Mechanism::cpuset2 && !partition_;
  if (found && shield_plan(files, options_.cores).mechanism != Mechanism::cpuset2) state = "not isolated";
  if (state != "isolated") {
    partition_ = false;
    moves_ = true;
    tried_.clear();  // before 6.2 the kernel has given them all cores again
    facts_.mechanism = Mechanism::affinity;
    facts_.notes.push_back(
        fmt::format("the kernel ended the partition of cgroup v2 (\"{}\"): affinity alone keeps tasks away", state));
    const Result<> moved = move_tasks();
    return moved ? Result<std::string>(facts_.notes.back()) : moved.error();
  }
  if (!moves_) return std::string();
  const Result<> moved = move_tasks(true);
  return moved ? Result<std::string>(std::string()) : moved.error();
}

Result<> Shield::move_tasks(bool kernel) {
  const Who who{.leave = options_.leave, .only = options_.only, .kernel = kernel};
  for (int round = 0; round < kMostRounds; ++round) {
    std::vector<Change> moves = moves_plan(HostFiles(), options_.cores, who);
    std::erase_if(moves, [&](const Change& each) { return tried_.contains({each.path, each.start_time_ticks}); });
    if (moves.empty()) return done();
    const auto steps = apply(journal_, writer_, moves);
    if (!steps) return steps.error();
    for (const Step& step : *steps) {
      tried_.emplace(step.change.path, step.change.start_time_ticks);
      if (step.outcome == Outcome::refused && step.error == EPERM) return Error{kNoRight};
      facts_.moved += step.outcome == Outcome::done ? 1 : 0;
      facts_.refused += step.outcome == Outcome::refused ? 1 : 0;
    }
  }
  facts_.notes.push_back("tasks start faster than they are moved: some may still run on the robot's core");
  return done();
}

Result<> Shield::change_settings() {
  const Plan plan = runtime_plan(HostFiles(options_.root), options_.cores);
  const auto steps = apply(journal_, writer_, plan.changes);
  if (!steps) return steps.error();
  for (const Step& step : *steps)
    if (step.well())
      ++facts_.settings;
    else
      facts_.notes.push_back(fmt::format("{} stays {}: {}", step.change.path, step.change.before, step.why()));
  for (const NotDone& each : plan.not_done) facts_.notes.push_back(each.path + ": " + each.why);
  facts_.notes.insert(facts_.notes.end(), plan.notes.begin(), plan.notes.end());
  return done();
}

// All of the groups, or none of them.
Result<> Shield::take_out_of_balancing(const ShieldPlan& plan) {
  if (plan.groups.empty()) return done();
  const auto give_up = [&](const std::string& why) -> Result<> {
    facts_.notes.push_back(why + ": affinity alone keeps tasks away");
    facts_.mechanism = Mechanism::affinity;
    std::vector<Entry> groups = journal_.entries();
    std::erase_if(groups, [](const Entry& each) { return each.change.item != kGroups; });
    const auto undone = revert_entries(journal_, writer_, groups, true);
    return undone ? done() : undone.error();
  };
  // What is left on the core once it is not balanced is left there for good.
  if (facts_.refused > 0) return give_up(fmt::format("{} tasks could not be moved", facts_.refused));
  for (const Change& change : plan.groups) {
    const auto steps = apply(journal_, writer_, {change});
    if (!steps) return steps.error();
    if (!steps->front().well()) return give_up(change.path + ": " + steps->front().why());
  }
  return done();
}

Result<Lowered> Shield::lower() {
  if (!up_) return Lowered();
  up_ = false;
  auto undone = undo_all(journal_, writer_, options_.only);
  if (!undone) return Error{"the shield could not be lowered: " + undone.message() + "; next: lithe tune revert"};
  journal_.remove();
  if (undone->failed.empty()) return undone;
  return Error{fmt::format("the shield could not be lowered in full: {}; next: lithe tune revert",
                           fmt::join(undone->failed, "; "))};
}

std::string born_words(const Lowered& lowered) {
  const std::size_t count = lowered.born.size(), named = std::min<std::size_t>(count, 8);
  if (count == 0) return "";
  const std::vector<std::string> names(lowered.born.begin(), lowered.born.begin() + static_cast<std::ptrdiff_t>(named));
  return fmt::format(
      "tasks started while the shield was up have all cores again: {}{}; one that chose fewer itself in that time has "
      "to do so anew",
      fmt::join(names, ", "), count > named ? fmt::format(" and {} more", count - named) : "");
}

std::string shield_words(const ShieldFacts& facts) {
  const std::string cores = cpu_list(facts.cores);
  std::string text = fmt::format("core{} {}, {}", facts.cores.size() == 1 ? "" : "s", cores, word_of(facts.mechanism));
  text += fmt::format(": {} tasks moved", facts.moved);
  if (facts.refused > 0) text += fmt::format(", {} refused", facts.refused);
  return text + fmt::format(", {} settings", facts.settings);
}

}  // namespace lithe::host
