// SPDX-License-Identifier: Apache-2.0
#include "host/tune/tune.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <iterator>
#include <utility>

#include "host/tune/boot/boot.hpp"
#include "host/tune/shield/shield.hpp"
#include "host/tune/values.hpp"
#include "spine/core/host/cores.hpp"

namespace lithe::host {
namespace {

void add(TunePlan& plan, Plan part) {
  std::move(part.changes.begin(), part.changes.end(), std::back_inserter(plan.changes));
  std::move(part.not_done.begin(), part.not_done.end(), std::back_inserter(plan.not_done));
  std::move(part.notes.begin(), part.notes.end(), std::back_inserter(plan.notes));
}

// The boot line, for the first of the robot's cores (the Spine's) without a tick.
Result<BootPlan> boot_line(const Target& target) {
  const std::vector<int> rest = cores_without(target.all_cores, target.cores);
  return boot_plan(HostFiles(target.root),
                   {.isolated = target.cores, .tickless = {target.cores.front()}, .housekeeping = rest.front()});
}

void add_boot_line(const Target& target, TunePlan& plan) {
  Result<BootPlan> boot = boot_line(target);
  if (!boot) {
    plan.not_done.push_back({"boot_line", "boot line", boot.message()});
    return;
  }
  plan.board = boot->board;
  plan.commands = boot->commands;
  add(plan, {.changes = std::move(boot->changes), .not_done = {}, .notes = std::move(boot->notes)});
}

// One of the two journals, and the changes that it keeps.
struct Book {
  bool lasting;

  std::string path(const Target& target) const { return target.root + (lasting ? kLastingJournal : kRunJournal); }
  std::string boot(const Target& target) const {
    return lasting ? "" : HostFiles(target.root).read("/proc/sys/kernel/random/boot_id").value;
  }
  bool keeps(const Change& change) const { return lasting == (change.kind == ChangeKind::file); }
};

constexpr Book kRun{false}, kLasting{true};

// A shield that is up changes the same settings; one that was left over is undone first.
Result<> lower_old_shield(const Target& target, TuneResult& result) {
  if (target.image) return done();
  const auto lowered = Shield::lower_left_over(target.root + kShieldJournal);
  if (!lowered) return lowered.error();
  if (lowered->count > 0) {
    result.notes.push_back(
        fmt::format("the shield that a killed robot left was lowered: {} changes undone", lowered->count));
  }
  for (const std::string& each : lowered->failed) result.notes.push_back("still shielded: " + each);
  result.still_shielded = !lowered->failed.empty();
  return done();
}

Result<> apply_to(const Book& book, const Target& target, const std::vector<Change>& changes, const StepHook& hook,
                  TuneResult& result) {
  std::vector<Change> its;
  std::copy_if(changes.begin(), changes.end(), std::back_inserter(its),
               [&](const Change& each) { return book.keeps(each); });
  if (its.empty()) return done();
  auto journal = Journal::open(book.path(target), book.boot(target), true, hook);
  if (!journal) return journal.error();
  auto steps = apply(*journal, Writer(target.root, hook), its);
  if (!steps) return steps.error();
  std::move(steps->begin(), steps->end(), std::back_inserter(result.steps));
  journal->remove();  // only when nothing was changed
  return done();
}

Result<> revert_in(const Book& book, const Target& target, bool forget, const StepHook& hook, TuneResult& result) {
  auto journal = Journal::open(book.path(target), book.boot(target), false, hook);
  if (!journal) return journal.error();
  if (journal->unreadable_lines() > 0) {
    result.notes.push_back(fmt::format("{}: {} lines cannot be read: what they say is not undone", journal->path(),
                                       journal->unreadable_lines()));
  }
  auto steps = revert(*journal, Writer(target.root, hook), forget);
  if (!steps) return steps.error();
  std::move(steps->begin(), steps->end(), std::back_inserter(result.steps));
  if (book.lasting) ::rmdir(book.path(target).substr(0, book.path(target).rfind('/')).c_str());  // ours, when empty
  return done();
}

}  // namespace

bool TuneResult::well() const {
  return !still_shielded && std::all_of(steps.begin(), steps.end(), [](const Step& each) { return each.well(); });
}

TunePlan tune_plan(const Target& target) {
  const HostFiles files(target.root);
  TunePlan plan;
  if (!target.image) add(plan, runtime_plan(files, target.cores));
  add(plan, lasting_plan(files));
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
  if (const Result<> part = lower_old_shield(target, result); !part) return part.error();
  for (const Book& book : {kRun, kLasting}) {
    if (const Result<> part = apply_to(book, target, changes, hook, result); !part) return part.error();
  }
  return result;
}

Result<TuneResult> tune_revert(const Target& target, bool forget, const StepHook& hook) {
  TuneResult result;
  if (const Result<> part = lower_old_shield(target, result); !part) return part.error();
  for (const Book& book : {kLasting, kRun}) {
    if (book.lasting || !target.image) {
      if (const Result<> part = revert_in(book, target, forget, hook, result); !part) return part.error();
    }
  }
  const bool boots = std::any_of(result.steps.begin(), result.steps.end(), [](const Step& each) {
    return each.change.item == "boot_line" && each.outcome == Outcome::done;
  });
  if (boots && target.all_cores.size() > 1) {  // the commands are the same for any core
    Target any = target;
    any.cores = {target.all_cores.back()};
    const Result<BootPlan> boot = boot_line(any);
    if (boot) result.commands = boot->commands;
  }
  return result;
}

}  // namespace lithe::host
