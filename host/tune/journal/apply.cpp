// SPDX-License-Identifier: Apache-2.0
#include "host/tune/journal/journal.hpp"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

bool is_ours(const Entry& entry, const Now& now) { return !now.absent && contains(entry.ours, now.value); }

// A file that vanished was removed by somebody; a task that ended and a setting without its file are just gone.
bool may_be_gone(const Change& change) {
  return change.kind == ChangeKind::affinity || change.kind == ChangeKind::setting;
}

Step undo(const Writer& writer, const Entry& entry) {
  const Change& change = entry.change;
  Step step{.change = change};
  writer.clean(change);
  const Now now = writer.now(change), wanted = before(change);
  if (now.error != 0) {
    step.outcome = Outcome::refused;
    step.error = now.error;
  } else if (now == wanted) {
    step.outcome = Outcome::already;
  } else if (now.absent && may_be_gone(change)) {
    step.outcome = Outcome::gone;
  } else if (!is_ours(entry, now)) {
    step.outcome = Outcome::foreign;
    step.found = now.absent ? "nothing: it was removed" : now.value;
  } else {
    step.error = writer.set(change, wanted);
    // A controller that another group uses by now is that group's.
    const bool taken = change.kind == ChangeKind::controller && step.error == EBUSY;
    step.outcome = taken ? Outcome::gone : outcome_of(change, step.error);
  }
  return step;
}

}  // namespace

// Of an interrupt, EIO says that nobody may move it, EPERM that its driver has given each core one of its own; missing
// rights are EACCES, as they are found when the file is opened.
Outcome outcome_of(const Change& change, int error) {
  if (error == 0) return Outcome::done;
  if (error == ESRCH) return Outcome::gone;
  const bool is_fixed = change.item == "irq_affinity" && (error == EIO || error == EPERM);
  return is_fixed ? Outcome::fixed : Outcome::refused;
}

std::string Step::why() const {
  if (outcome == Outcome::refused) return std::strerror(error);
  if (outcome != Outcome::foreign) return "";
  const bool short_enough = found.size() <= 40 && found.find('\n') == std::string::npos;
  return "somebody else changed it" + (short_enough ? " to " + found : "");
}

Result<std::vector<Step>> apply(Journal& journal, const Writer& writer, const std::vector<Change>& changes) {
  std::vector<Step> steps;
  for (const Change& change : changes) {
    Step step{.change = change};
    const Now now = writer.now(change);
    if (now == after(change)) {
      step.outcome = Outcome::already;
    } else if (change.kind == ChangeKind::affinity && now.absent) {
      step.outcome = Outcome::gone;
    } else if (now.error != 0) {
      step.outcome = Outcome::refused;
      step.error = now.error;
    } else if (!(now == before(change))) {
      step.outcome = Outcome::foreign;
      step.found = now.absent ? "nothing: it was removed" : now.value;
    } else {
      const Result<std::uint64_t> number = journal.begin(change);
      if (!number) return number.error();
      step.error = writer.set(change, after(change));
      writer.step();
      const Now then = writer.now(change);
      // The kernel may write a value in its own way, or take the write without doing it.
      if (step.error == 0 && then == before(change)) step.error = EINVAL;
      step.outcome = outcome_of(change, step.error);
      const Result<> noted = journal.finish(*number, step.error, then.error == 0 ? then.value : change.after);
      if (!noted) return noted.error();
    }
    steps.push_back(std::move(step));
  }
  return steps;
}

Result<std::vector<Step>> revert_entries(Journal& journal, const Writer& writer, std::vector<Entry> entries,
                                         bool forget) {
  std::vector<Step> steps;
  Result<> noted = done();
  std::ranges::reverse(entries);
  for (const Entry& entry : entries) {
    Step step = undo(writer, entry);
    if (step.well() || (forget && step.outcome == Outcome::foreign)) {
      // A full disk: the rest is undone all the same, and what is undone a second time has its value already.
      if (const Result<> dropped = journal.drop(entry.number, step.well() ? kUndone : "left to who changed it");
          !dropped)
        noted = dropped;
    }
    steps.push_back(std::move(step));
  }
  if (!noted) return noted.error();
  return steps;
}

Result<std::vector<Step>> revert(Journal& journal, const Writer& writer, bool forget) {
  auto steps = revert_entries(journal, writer, journal.entries(), forget);
  if (steps) journal.remove(forget);
  return steps;
}

}  // namespace lithe::host
