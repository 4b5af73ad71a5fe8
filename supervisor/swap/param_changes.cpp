// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/param_changes.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"

namespace lithe::control {

using wire::EventKind;

namespace {

// "kp_nm_rad = 40 (now 4)".
std::string in_words(const Json& values, const Json& before) {
  std::string words;
  for (const auto& [name, value] : values.items()) {
    words += fmt::format("{}{} = {:g} (now {:g})", words.empty() ? "" : ", ", name, value.get<double>(),
                         before.value(name, 0.0));
  }
  return words;
}

// "kp_nm_rad = 4 again, kd_nm_s_rad = 0.05 again".
std::string again(const Json& before) {
  std::string words;
  for (const auto& [name, value] : before.items())
    words += fmt::format("{}{} = {:g} again", words.empty() ? "" : ", ", name, value.get<double>());
  return words;
}

Json merged(Json values, const Json& newer) {
  for (const auto& [name, value] : newer.items()) values[name] = value;
  return values;
}

Refusal no_law() {
  return {"refused_law", "no law is running, so there is no parameter to set", "swap a law in first"};
}

// True when the Spine refused the change; false when its outcome is unknown.
bool outcome_is_known(const Refusal& refusal) {
  return refusal.code != "timeout" && refusal.code != "stopping" && refusal.code != "robot_fault";
}

}  // namespace

std::optional<Refusal> wrong_param(const Json& params, const Json& law) {
  for (const auto& [name, value] : params.items()) {
    const Json known = law.value("params", Json::array());
    const auto found = std::find_if(known.begin(), known.end(),
                                    [&name = name](const Json& each) { return each.value("name", "") == name; });
    if (found == known.end()) {
      return Refusal{"unknown_param", fmt::format("the new law has no parameter '{}'", name),
                     known.empty() ? "it has none: leave it out" : "it has: " + joined(known, [](const Json& each) {
                                                                     return each.value("name", "");
                                                                   })};
    }
    if (!value.is_number() || !(value >= (*found)["min"]) || !(value <= (*found)["max"])) {
      return Refusal{"refused_range",
                     fmt::format("{} = {} is outside [{}, {}]", name, value.dump(), (*found)["min"].dump(),
                                 (*found)["max"].dump()),
                     "the running law is unchanged; choose a value inside the range"};
    }
  }
  return std::nullopt;
}

Json all_params(const Json& params, const Json& law) {
  Json values = Json::object();
  for (const Json& each : law.value("params", Json::array())) {
    const std::string name = each.value("name", "");
    values[name] = params.value(name, each.value("value", 0.0));
  }
  return values;
}

void put_params(const Json& params, const Json& law, wire::StageRequest& request) {
  std::uint32_t index = 0;
  for (const Json& each : law.value("params", Json::array())) {
    const auto asked = params.find(each.value("name", ""));
    if (asked != params.end() && request.param_count < wire::kNparam) {
      request.param_index[request.param_count] = index;
      request.param_value[request.param_count++] = asked->get<double>();
    }
    ++index;
  }
}

void ParamChanges::set(const Json& values, bool dry_run, Callback callback, std::int64_t now_ns) {
  const auto law = help_.spine.running_law();
  if (!law) return callback(no_law());
  const auto command = params_command(values, law->info);
  if (const auto* refusal = std::get_if<Refusal>(&command)) return callback(*refusal);
  if (waiting_.size() >= kMostWaiting) {
    return callback(
        Refusal{"busy", fmt::format("{} changes of parameters wait already", kMostWaiting), "try again later"});
  }
  Change change{next_number_++, *law, values, std::get<wire::Command>(command), std::move(callback)};
  change.record = {{"change", change.number}, {"asked_ns", now_ns}, {"verdict", "submitted"}, {"values", values}};
  change.dry_run = dry_run;
  waiting_.push_back(std::move(change));
  if (waiting_.size() == 1) begin();
}

Json ParamChanges::result_of(const Change& change) {
  Json result = Json::object();
  for (const char* key : {"change", "trial_ms", "warnings"})
    if (change.record.contains(key)) result[key] = change.record[key];
  return result;
}

ParamChanges::Change* ParamChanges::head(std::uint64_t number) {
  return !waiting_.empty() && waiting_.front().number == number ? &waiting_.front() : nullptr;
}

// Another law may run by now, or other values may be in force.
void ParamChanges::begin() {
  Change& change = waiting_.front();
  auto law = help_.spine.running_law();
  if (!law || law->info.law_id != change.law.info.law_id)
    return settle(refusal_of(wire::CommandKind::set_params, wire::CommandResult::refused_law, {}));
  change.law = std::move(*law);
  Json before = Json::object();
  for (const auto& [name, value] : change.values.items()) before[name] = change.law.values[name];
  change.record["before"] = std::move(before);
  if (help_.trial == nullptr) return send(change);
  auto request = help_.laws.request_of(change.law, request_otherwise());
  if (!request) {
    return refuse(change, {"trial_unavailable",
                           fmt::format("law '{}' was brought in by an earlier supervisor, and its object is not in the "
                                       "cache any more: its parameters cannot be tried",
                                       text_of(change.law.info.name)),
                           "nothing was changed; swap the law in again, with these parameters"});
  }
  request->params = merged(change.law.values, change.values);
  help_.trial->attempt(
      *request, [this, number = change.number](const Answer& answer) { tried(number, answer); }, monotonic_ns());
}

TrialRequest ParamChanges::request_otherwise() const {
  TrialRequest request;
  request.budget_ns = robots_terms_.budget_ns();
  request.box_ms = static_cast<int>(robots_terms_.box_ms);
  request.recording = text_of(help_.spine.info().robot);
  return request;
}

void ParamChanges::tried(std::uint64_t number, const Answer& answer) {
  Change* change = head(number);
  if (change == nullptr) return;
  if (const auto* found = std::get_if<Refusal>(&answer)) {
    Refusal refusal = *found;
    refusal.message = fmt::format("{}: {}", in_words(change->values, change->law.values), found->message);
    if (refusal.code == "trial_failed") {
      const Json report = refusal.detail.is_object() ? refusal.detail.value("trial", Json::object()) : Json::object();
      const Json hints = report.value("hints", Json::array());
      refusal.next =
          "nothing was changed; " +
          (hints.empty() ? "choose values nearer to those that hold, or change the law" : hints[0].get<std::string>());
    }
    return refuse(*change, refusal);
  }
  change->trial = std::get<Json>(answer);
  change->record["trial_ms"] = change->trial.value("ms", 0.0);
  Json warnings = change->trial.value("warnings", Json::array());
  for (const std::string& each : help_.laws.worse_than(change->law, change->trial)) warnings.push_back(each);
  const Json values = merged(change->law.values, change->values);
  if (const std::string missing = missing_sensor(values, help_.spine.info()); !missing.empty())
    warnings.push_back(missing);
  change->record["warnings"] = std::move(warnings);
  send(*change);
}

void ParamChanges::send(Change& change) {
  if (change.dry_run) return settle(result_of(change));
  keep(change, "sent");
  const std::uint64_t number = change.number;
  const std::uint64_t id = help_.commands.send(
      change.command, [this, number](const Answer& answer) { answered(number, answer); }, monotonic_ns());
  if (Change* still = head(number))  // it may have been refused and removed
    still->command_id = id;
}

void ParamChanges::answered(std::uint64_t number, const Answer& answer) {
  Change* change = head(number);
  if (change == nullptr) return;
  if (const auto* refusal = std::get_if<Refusal>(&answer)) return refuse(*change, *refusal);
  if (change->record["verdict"] == "sent")  // its event was lost
    keep(*change, "taken");
  help_.laws.passed_again(change->law.info.request_id, merged(change->law.values, change->values), change->trial);
  const Json result = result_of(*change);
  help_.log.note(change->law.info.request_id, "params_set", in_words(change->values, change->law.values));
  settle(result);
}

void ParamChanges::refuse(Change& change, const Refusal& refusal) {
  if (change.dry_run) return settle(refusal);
  Json told = refusal.to_json();
  told.erase("detail");
  change.record["error"] = std::move(told);
  keep(change, outcome_is_known(refusal) ? "refused" : "not_confirmed");
  help_.log.note(change.law.info.request_id, "params_refused", refusal.message);
  settle(refusal);
}

void ParamChanges::settle(const Answer& answer) {
  const Change done = std::move(waiting_.front());
  waiting_.pop_front();
  done.callback(answer);
  if (!waiting_.empty()) begin();
}

void ParamChanges::refuse_all(const Refusal& reason) {
  std::deque<Change> all = std::exchange(waiting_, {});
  for (Change& each : all) {
    if (each.record["verdict"] == "sent") keep(each, "not_confirmed");
    each.callback(reason);
  }
}

void ParamChanges::on_event(const wire::Event& event) {
  switch (static_cast<EventKind>(event.kind)) {
    case EventKind::params_applied:
      return applied(event);
    case EventKind::law_unproven:
      return event.value != 0 ? judge_open(event.code, "unproven", text_of(event.text)) : void();
    case EventKind::params_confirmed:
    case EventKind::law_confirmed:  // confirms also the values that were set during the law's own probation
      return judge_open(event.code, "confirmed", "");
    case EventKind::params_reverted:
      return judge_open(event.code, "reverted", text_of(event.text));
    case EventKind::law_rolled_back:  // the laws after the one that runs now left with their values
      for (auto left = past_.upper_bound(event.code); left != past_.end(); ++left)
        judge_open(left->first, "rolled_back", "with its law: " + text_of(event.text));
      return;
    case EventKind::law_retired:
      past_.erase(event.code);
      return;
    default:
      return;
  }
}

void ParamChanges::applied(const wire::Event& event) {
  if (!waiting_.empty() && event.request_id != 0 && waiting_.front().command_id == event.request_id)
    keep(waiting_.front(), "taken");
  else if (text_of(event.text) == "as before the last change")
    judge_open(event.code, "reverted", "asked for", true);
}

void ParamChanges::keep(Change& change, const char* verdict) {
  change.record["verdict"] = verdict;
  Past& past = past_[change.law.info.law_id];
  past.request_id = change.law.info.request_id;
  Json& record = past.records[change.number] = change.record;
  record["law"] = text_of(change.law.info.name);
  if (past.records.size() > kMostKept) past.records.erase(past.records.begin());
  tell(past);
}

// Changes that are in force and whose verdict is still open.
void ParamChanges::judge_open(std::uint32_t law_id, const std::string& verdict, const std::string& reason,
                              bool newest_only) {
  const auto past = past_.find(law_id);
  if (past == past_.end()) return;
  std::vector<Json*> judged;
  Json before = Json::object();  // the first of these changes
  for (auto each = past->second.records.rbegin(); each != past->second.records.rend(); ++each) {
    Json& record = each->second;
    if ((record["verdict"] != "taken" && record["verdict"] != "unproven") || (!judged.empty() && newest_only)) continue;
    judged.push_back(&record);
    before.update(record.value("before", Json::object()));
    record["verdict"] = verdict;
    record.erase("reason");
    record.erase("next");
    if (!reason.empty()) record["reason"] = reason;
    if (const std::string_view next = next_step(reason); !next.empty()) record["next"] = std::string(next);
  }
  if (judged.empty()) return;
  if (verdict == "reverted") {
    for (Json* record : judged)
      for (const auto& [name, value] : (*record)["values"].items()) (*record)["went_back_to"][name] = before[name];
    help_.log.note(past->second.request_id, "params_went_back", again(before));  // incidents and agents read it there
  }
  tell(past->second);
}

void ParamChanges::tell(const Past& past) {
  Json all = Json::array();
  for (const auto& [number, record] : past.records) all.push_back(record);
  last_ = all.back();
  keep_(past.request_id, all);
}

}  // namespace lithe::control
