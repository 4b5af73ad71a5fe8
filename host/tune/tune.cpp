// SPDX-License-Identifier: Apache-2.0
#include "host/tune/tune.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <iterator>
#include <set>
#include <utility>

#include "host/tune/boot/boot.hpp"
#include "host/tune/lasting.hpp"
#include "host/tune/shield/shield.hpp"
#include "host/tune/shield/shield_plan.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/shield_group.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"

namespace lithe::host {
namespace {

constexpr const char* kReloadRules = "udevadm control --reload && udevadm trigger";

void add(TunePlan& plan, Plan part) {
  std::ranges::move(part.changes, std::back_inserter(plan.changes));
  std::ranges::move(part.not_done, std::back_inserter(plan.not_done));
  std::ranges::move(part.notes, std::back_inserter(plan.notes));
}

HostFiles files_of(const Target& target) { return HostFiles(target.root, target.image); }

void add_boot_line(const Target& target, TunePlan& plan) {
  const std::vector<int> rest = cores_without(target.all_cores, target.cores);
  const int spine = contains(target.cores, target.spine) ? target.spine : target.cores.front();
  Result<BootPlan> boot =
      boot_plan(files_of(target), {.isolated = target.cores, .tickless = {spine}, .housekeeping = rest.front()});
  if (!boot) return plan.not_done.push_back({kBootItem, "boot line", boot.message()});
  plan.board = boot->board;
  plan.commands.insert(plan.commands.end(), boot->commands.begin(), boot->commands.end());
  add(plan, {.changes = std::move(boot->changes), .not_done = {}, .notes = std::move(boot->notes)});
}

void add_partition(const Target& target, TunePlan& plan) {
  const HostFiles files = files_of(target);
  add(plan, {.changes = partition_plan(files, target.cores), .not_done = {}, .notes = {}});
  const bool has_one =
      partition_state(files) == "isolated" || (!plan.changes.empty() && plan.changes.back().item == kPartitionItem);
  if (has_one) {
    plan.notes.push_back(fmt::format("with a partition, only what root starts can have cores {}: sudo lithe run",
                                     cpu_list(target.cores)));
  } else {
    plan.not_done.push_back({kPartitionItem, kShieldGroup, "this machine has no cpusets of cgroup v2"});
  }
}

// Repeats the settings at every start.
void add_unit(const Target& target, TunePlan& plan) {
  if (target.program.empty()) return;
  const HostFiles files = files_of(target);
  Plan unit = unit_plan(files, target.program, target.cores, target.partition);
  const std::string folder = kUnitFolder;
  // Not enabled, as after an apply that was killed before it could tell the command.
  const bool waits =
      files.has(folder + "/" + kUnit) && !contains(files.list(folder + "/multi-user.target.wants"), std::string(kUnit));
  const std::string root = target.image ? fmt::format("--root={} ", shell_word(target.root)) : "";
  if (!unit.changes.empty() || waits) plan.commands.push_back(fmt::format("systemctl {}enable {}", root, kUnit));
  add(plan, std::move(unit));
}

void add_rules(const Target& target, TunePlan& plan) {
  Plan rules = rules_plan(files_of(target), *target.robot);
  if (!rules.changes.empty()) plan.commands.push_back(kReloadRules);
  add(plan, std::move(rules));
}

// One of the two journals, and the changes that it keeps.
struct Book {
  bool lasting;

  std::string path(const Target& target) const { return target.root + (lasting ? kLastingJournal : kRunJournal); }
  std::string boot(const Target& target) const { return lasting ? "" : boot_id(target.root); }
  bool keeps(const Change& change) const { return lasting == (change.kind == ChangeKind::file); }
};

constexpr Book kRun{false}, kLasting{true};

void tell_unreadable(const std::string& journal, std::size_t lines, bool forget, TuneResult& result) {
  if (lines == 0) return;
  result.notes.push_back(fmt::format("{}: {} lines cannot be read: what they say is not undone{}", journal, lines,
                                     forget ? "" : " (revert --force gives them up)"));
  result.incomplete = result.incomplete || !forget;
}

// A shield that is up changes the same settings; one that was left over is undone first.
Result<> lower_old_shield(const Target& target, bool forget, TuneResult& result) {
  if (target.image) return done();
  const std::string journal = target.root + kShieldJournal;
  const auto lowered = Shield::lower_left_over({.root = target.root, .journal = journal}, forget);
  if (!lowered) return lowered.error();
  tell_unreadable(journal, lowered->unreadable, forget, result);
  if (lowered->count > 0) {
    result.notes.push_back(
        fmt::format("the shield that a killed robot left was lowered: {} changes undone", lowered->count));
  }
  if (!lowered->born.empty()) result.notes.push_back(born_words(*lowered));
  for (const std::string& each : lowered->failed) result.notes.push_back("still shielded: " + each);
  result.still_shielded = !lowered->failed.empty();
  return done();
}

Result<> apply_to(const Book& book, const Target& target, const std::vector<Change>& changes, const StepHook& hook,
                  TuneResult& result) {
  std::vector<Change> its;
  std::ranges::copy_if(changes, std::back_inserter(its), [&](const Change& each) { return book.keeps(each); });
  if (its.empty()) return done();
  const auto partition =
      std::ranges::stable_partition(its, [](const Change& each) { return each.item != kPartitionItem; });
  const std::vector<Change> groups(partition.begin(), partition.end());
  its.erase(partition.begin(), partition.end());
  auto journal = Journal::open(book.path(target), book.boot(target), true, hook);
  if (!journal) return journal.error();
  auto steps = apply(*journal, Writer(target.root, hook), its);
  if (!steps) return steps.error();
  std::ranges::move(*steps, std::back_inserter(result.steps));
  if (!groups.empty()) {
    auto made = make_partition(*journal, Writer(target.root, hook), groups);
    if (!made) return made.error();
    std::ranges::move(made->steps, std::back_inserter(result.steps));
    if (!made->why_not.empty()) result.notes.push_back("no partition of cgroup v2: " + made->why_not);
    result.no_partition = !made->why_not.empty();
  }
  journal->remove();  // only when nothing was changed
  return done();
}

Result<> revert_in(const Book& book, const Target& target, bool forget, const StepHook& hook, TuneResult& result,
                   std::set<std::string>& undone) {
  auto journal = Journal::open(book.path(target), book.boot(target), false, hook);
  if (!journal) return journal.error();
  tell_unreadable(journal->path(), journal->unreadable_lines(), forget, result);
  auto partition = unmake_partition(*journal, Writer(target.root, hook));
  if (!partition) return partition.error();
  std::ranges::copy_if(*partition, std::back_inserter(result.steps),
                       [](const Step& each) { return each.well(); });  // the rest is tried again
  auto steps = revert(*journal, Writer(target.root, hook), forget);
  if (!steps) return steps.error();
  std::ranges::move(*steps, std::back_inserter(result.steps));
  undone.insert(journal->undone().begin(), journal->undone().end());
  if (book.lasting) ::rmdir(book.path(target).substr(0, book.path(target).rfind('/')).c_str());  // ours, when empty
  return done();
}

}  // namespace

void TuneResult::refuse(const Error& why) {
  notes.push_back("the rest was not done: " + why.message);
  incomplete = true;
}

bool TuneResult::well() const {
  return !still_shielded && !no_partition && !incomplete &&
         std::ranges::all_of(steps, [](const Step& each) { return each.well(); });
}

TunePlan tune_plan(const Target& target) {
  const HostFiles files = files_of(target);
  TunePlan plan;
  if (!target.image) add(plan, runtime_plan(files, target.cores));
  if (target.partition && !target.image) add_partition(target, plan);
  if (!target.files) return plan;
  add(plan, lasting_plan(files));
  add_unit(target, plan);
  if (target.robot) add_rules(target, plan);
  if (target.image) {
    plan.notes.push_back(fmt::format(
        "an image does not tell how many cores its machine has: planned for {}, the robot's are {} (--cores)",
        cpu_list(target.all_cores), cpu_list(target.cores)));
  }
  if (target.cores.size() < target.all_cores.size() && !target.cores.empty()) add_boot_line(target, plan);
  return plan;
}

Result<TuneResult> tune_apply(const Target& target, const std::vector<Change>& changes, const StepHook& hook) {
  TuneResult result;
  if (const Result<> part = lower_old_shield(target, false, result); !part) return part.error();
  // The lasting ones first: on a read-only disk their journal is refused, and nothing has been changed then.
  for (const Book& book : {kLasting, kRun}) {
    const Result<> part = apply_to(book, target, changes, hook, result);
    if (!part && result.steps.empty()) return part.error();
    if (!part) result.refuse(part.error());
  }
  const bool boots = std::ranges::any_of(
      result.steps, [](const Step& each) { return each.outcome == Outcome::done && each.change.reboot; });
  if (boots && !target.image) result.notes.push_back("the boot line is in force after a reboot");
  return result;
}

Result<TuneResult> tune_revert(const Target& target, bool forget, const StepHook& hook) {
  TuneResult result;
  if (const Result<> part = lower_old_shield(target, forget, result); !part) return part.error();
  // The lasting ones last: their journal says until the end what was undone. One that is killed tells no commands.
  std::set<std::string> undone;
  for (const Book& book : {kRun, kLasting}) {
    if (book.lasting || !target.image) {
      const Result<> part = revert_in(book, target, forget, hook, result, undone);
      if (!part && result.steps.empty()) return part.error();
      if (!part) result.refuse(part.error());
    }
  }
  const auto tell = [&](const std::vector<std::string>& commands) {
    result.commands.insert(result.commands.end(), commands.begin(), commands.end());
  };
  if (undone.contains(kRulesItem) && !target.image) tell({kReloadRules});
  if (undone.contains(kUnitItem))
    tell({fmt::format("rm -f {}{}/multi-user.target.wants/{}", target.image ? shell_word(target.root) : "", kUnitFolder,
                      kUnit)});
  if (undone.contains(kBootItem)) tell(boot_commands(files_of(target)));
  if (undone.contains(kBootItem) && !files_of(target).read("/sys/devices/system/cpu/isolated").value.empty())
    result.notes.push_back("the kernel keeps its isolated cores until the next boot");
  if (undone.contains(kSysctlItem) && !target.image)
    result.notes.push_back("what sysctl.d had set at the last boot stays until the next one");
  return result;
}

}  // namespace lithe::host
