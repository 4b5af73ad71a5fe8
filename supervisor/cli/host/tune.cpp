// SPDX-License-Identifier: Apache-2.0
// `lithe tune plan | apply | revert`.
#include "host/tune/tune.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>

#include "host/tune/shield/shield.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/host/target.hpp"

namespace lithe::cli {
namespace {

constexpr int kNotEverything = 1;
constexpr const char* kRevert = "revert";
constexpr std::size_t kMostWords = 60;  // of a value on one line

// The lines that differ, those before with "-" and those after with "+".
std::string difference(const std::string& before, const std::string& after) {
  std::vector<std::string_view> old_lines = lines_in(before), new_lines = lines_in(after);
  const auto [old_at, new_at] = std::ranges::mismatch(old_lines, new_lines);
  old_lines.erase(old_lines.begin(), old_at);
  new_lines.erase(new_lines.begin(), new_at);
  while (!old_lines.empty() && !new_lines.empty() && old_lines.back() == new_lines.back()) {
    old_lines.pop_back();
    new_lines.pop_back();
  }
  std::string text;
  for (const std::string_view line : old_lines) text += fmt::format("      - {}\n", line);
  for (const std::string_view line : new_lines) text += fmt::format("      + {}\n", line);
  return text;
}

bool is_text(const host::Change& change) { return change.kind == host::ChangeKind::file; }

std::string shown(const host::Change& change) {
  if (is_text(change)) {
    return fmt::format("  {}{}: {}{}\n{}", change.path, change.was_absent ? " (new)" : "", change.why,
                       change.reboot ? "; in force after a reboot" : "", difference(change.before, change.after));
  }
  return fmt::format("  {}  {} -> {}  ({})\n", change.path, change.before.substr(0, kMostWords), change.after,
                     change.why);
}

Json json_of(const host::Change& change) {
  return {{"kind", host::kChangeKinds[static_cast<std::size_t>(change.kind)]},
          {"item", change.item},
          {"path", change.path},
          {"before", change.was_absent ? Json(nullptr) : Json(change.before)},
          {"after", change.after},
          {"why", change.why},
          {"reboot", change.reboot}};
}

Json json_of(const host::TunePlan& plan, const host::Target& target) {
  Json changes = Json::array(), not_done = Json::array();
  for (const host::Change& each : plan.changes) changes.push_back(json_of(each));
  for (const host::NotDone& each : plan.not_done)
    not_done.push_back({{"item", each.item}, {"path", each.path}, {"why", each.why}});
  return {{"root", target.root},
          {"board", plan.board.empty() ? Json(nullptr) : Json(plan.board)},
          {"cores", cpu_list(target.cores)},
          {"changes", std::move(changes)},
          {"not_done", std::move(not_done)},
          {"notes", plan.notes},
          {"commands", plan.commands}};
}

std::string shown(const host::TunePlan& plan) {
  std::string text;
  for (const bool files : {false, true}) {
    std::string part;
    for (const host::Change& each : plan.changes) part += is_text(each) == files ? shown(each) : "";
    if (!part.empty()) text += (files ? "files\n" : "until the next boot\n") + part;
  }
  if (plan.changes.empty()) text += "nothing to change\n";
  if (!plan.not_done.empty()) text += "not possible here\n";
  for (const host::NotDone& each : plan.not_done) text += fmt::format("  {}: {}\n", each.path, each.why);
  for (const std::string& each : plan.notes) text += fmt::format("note: {}\n", each);
  return printable(text, true);  // a file may hold anything
}

std::string shown_commands(const std::vector<std::string>& commands) {
  std::string text;
  for (const std::string& each : commands) text += fmt::format("then run: {}\n", each);
  return text;
}

const char* word_of(host::Outcome outcome) {
  const char* const words[] = {"done", "already", "gone", "fixed", "refused", "foreign"};
  return words[static_cast<std::size_t>(outcome)];
}

Json json_of(const host::TuneResult& result) {
  Json steps = Json::array();
  for (const host::Step& each : result.steps) {
    Json step = json_of(each.change);
    step["outcome"] = word_of(each.outcome);
    if (!each.well()) step["reason"] = each.why();
    steps.push_back(std::move(step));
  }
  return {{"ok", result.well()}, {"steps", std::move(steps)}, {"notes", result.notes}, {"commands", result.commands}};
}

std::string shown(const host::TuneResult& result, const char* verb) {
  std::string text;
  std::size_t made = 0;
  std::string fixed;
  for (const host::Step& each : result.steps) {
    made += each.outcome == host::Outcome::done ? 1 : 0;
    if (each.outcome == host::Outcome::fixed) fixed += (fixed.empty() ? "" : ", ") + each.change.path;
    if (!each.well()) text += fmt::format("  {}: not {}: {}\n", each.change.path, verb, each.why());
  }
  if (!fixed.empty()) text += fmt::format("  the kernel keeps these interrupts where they are: {}\n", fixed);
  for (const std::string& each : result.notes) text += fmt::format("note: {}\n", each);
  text = printable(text, true);
  if (result.steps.empty() && !result.well()) return text;
  if (result.steps.empty()) return text + fmt::format("nothing had to be {}\n", verb);
  return text + fmt::format("{} of {} {}\n", made, result.steps.size(), verb);
}

// The command again, as it was typed: without its words it would mean another machine, or other cores.
std::string again(const TuneWords& words, const std::string& verb) {
  std::string text = "lithe tune " + verb;
  if (!words.robot.empty()) text += " " + shell_word(words.robot);
  if (!words.root.empty()) text += " --root " + shell_word(words.root);
  if (!words.cores.empty()) text += " --cores " + words.cores;
  for (const auto& [is_set, option] : {std::pair(words.partition, " --partition"),
                                       {words.no_files, " --no-files"},
                                       {words.force && verb == kRevert, " --force"}})
    if (is_set) text += option;
  return text;
}

// A journal that cannot be opened: mostly it takes root.
control::Refusal refusal_of(const Error& error, const TuneWords& words, const std::string& verb) {
  if (::geteuid() != 0) return {"no_tune", error.message, "sudo " + again(words, verb)};
  const bool files = words.root.empty() && !words.no_files && verb != kRevert;
  return {"no_tune", error.message,
          "see what is meant: " + again(words, "plan") + (files ? "; on a read-only disk: --no-files" : "")};
}

}  // namespace

int tune_plan(const Context& context, const TuneWords& words) {
  const host::Target target = target_of(words);
  const host::TunePlan plan = host::tune_plan(target);
  const Json json = json_of(plan, target);
  return finish(context, json, [&](const Json&) { fmt::print("{}{}", shown(plan), shown_commands(plan.commands)); });
}

int tune_apply(const Context& context, const TuneWords& words) {
  if (::geteuid() == 0 && words.root.empty()) {  // a killed shield narrows the cores, and holds some of the settings
    const auto left = host::Shield::lower_left_over();
    if (!left) throw refusal_of(left.error(), words, "apply");
    tell_left_over(*left);
  }
  const host::Target target = target_of(words);
  const host::TunePlan plan = host::tune_plan(target);
  if (::geteuid() != 0 && target.root.empty() && !plan.changes.empty()) {
    throw control::Refusal{"no_tune", fmt::format("these changes need root:\n{}", shown(plan)),
                           "sudo " + again(words, "apply")};
  }
  const auto result = host::tune_apply(target, plan.changes);
  if (!result) throw refusal_of(result.error(), words, "apply");
  Json json = json_of(*result);
  json["plan"] = json_of(plan, target);
  finish(context, json, [&](const Json&) {
    for (const host::NotDone& each : plan.not_done) fmt::print("  {}: not possible here: {}\n", each.path, each.why);
    for (const std::string& each : plan.notes) fmt::print("note: {}\n", each);
    fmt::print("{}{}", shown(*result, "changed"), shown_commands(plan.commands));
    if (!result->steps.empty())
      fmt::print("undo: lithe tune revert{}\n", target.image ? " --root " + shell_word(target.root) : "");
  });
  return result->well() && plan.not_done.empty() ? 0 : kNotEverything;
}

int tune_revert(const Context& context, const TuneWords& words) {
  const auto result = host::tune_revert(place_of(words), words.force);
  if (!result) throw refusal_of(result.error(), words, kRevert);
  finish(context, json_of(*result), [&](const Json&) {
    fmt::print("{}", result->steps.empty() && result->notes.empty() ? "nothing was changed by lithe tune\n"
                                                                    : shown(*result, "undone"));
    fmt::print("{}", shown_commands(result->commands));
  });
  // Forced: what somebody else changed stays theirs.
  const bool done = std::ranges::all_of(result->steps, [&](const host::Step& each) {
    return each.well() || (words.force && each.outcome == host::Outcome::foreign);
  });
  return done && !result->still_shielded && !result->incomplete ? 0 : kNotEverything;
}

}  // namespace lithe::cli
