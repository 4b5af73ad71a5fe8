// SPDX-License-Identifier: Apache-2.0
#include "supervisor/serve/verbs.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <optional>
#include <ranges>
#include <set>
#include <utility>
#include <variant>

#include "spine/core/time.hpp"
#include "supervisor/serve/status.hpp"

namespace lithe::control {
namespace {

constexpr int kMostSteps = 4;  // earlier laws that stay in the Spine

// A request as text. The supervisor opens no file for a client: it may read more than the client may.
SwapRequest read_request(const Json& args) {
  if (args.contains("path")) {
    throw Refusal{"usage", "a law is sent as text: the supervisor opens no files for its clients",
                  R"(read the file yourself and send its text: args {"source":"...","name":"pd.cpp"})"};
  }
  SwapRequest request{args.value("name", ""), args.value("source", ""), args.value("params", Json::object())};
  if (request.source.empty()) {
    throw Refusal{"usage", "no law was given: source is empty",
                  R"(send its text: args {"source":"...","name":"pd.cpp"})"};
  }
  if (!request.params.is_object())
    throw Refusal{"usage", "params is an object: {\"kp\":1.0}", "send args {\"params\":{\"NAME\":VALUE}}"};
  request.name = request.name.empty() ? "law.cpp" : request.name;
  return request;
}

Json in_short(const std::optional<RunningLaw>& law) {
  return {{"law", law ? Json(text_of(law->info.name)) : Json(nullptr)}, {"law_id", law ? law->info.law_id : 0}};
}

}  // namespace

Verbs::Verbs(Parts parts, Reply reply, std::function<void()> shutdown)
    : parts_(parts), reply_(std::move(reply)), shutdown_(std::move(shutdown)) {
  add_looks();
  add_commands();
  add_swaps();
}

std::function<void(const Answer&)> Verbs::later(const ReplyTo& to, const Done& done) const {
  return [this, to, done](const Answer& answer) {
    const Json* json = std::get_if<Json>(&answer);
    reply_(to, json != nullptr && done ? done(*json) : answer);
  };
}

void Verbs::add_looks() {
  verbs_["ping"] = [this](const ReplyTo& to, const Json&) { reply_(to, Json{{"pid", ::getpid()}}); };
  verbs_["status"] = [this](const ReplyTo& to, const Json&) {
    Json status = status_json(parts_.spine, parts_.robot);
    status["supervisor_pid"] = ::getpid();
    status["lawd_pid"] = parts_.lawd.pid();
    status["lawd_restarts"] = parts_.lawd.restarts();
    status["trial_pid"] = parts_.trial.pid();
    status["trial_restarts"] = parts_.trial.restarts();
    status["gates"] = parts_.swaps.gates_are_open() ? "open" : "closed";
    status["adopted"] = parts_.adopted;
    status["shield"] = parts_.shield;
    status["law_faults"] = parts_.swaps.law_faults();
    status["last_swap"] = parts_.swaps.last();
    status["last_params"] = parts_.swaps.last_params();
    status["records"] = parts_.swaps.records().string();
    status["certificates_error"] = parts_.swaps.certificates_error();
    status["incidents"] = parts_.incidents.brief();
    status["throttled"] = {
        {"now", parts_.throttle.active()}, {"times", parts_.throttle.times()}, {"why", parts_.throttle.why()}};
    status["stopped_by"] = parts_.log.last_stop();
    if (status["law_suspected"] == true) status["law_suspected"] = parts_.log.last_suspicion();
    if (const std::string holder = parts_.spine.estop_holder(); !holder.empty()) status["estop_held_by"] = holder;
    status["not_ready"] = parts_.drives_told;
    status["alarms"] = alarms_of(status);
    reply_(to, status);
  };
  verbs_["events"] = [this](const ReplyTo& to, const Json& args) {
    const auto limit = std::min<std::uint64_t>(args.value("limit", std::uint64_t{EventLog::kDepth}), EventLog::kDepth);
    const std::uint64_t newest = parts_.log.last() - std::min(parts_.log.last(), limit);
    reply_(to, parts_.log.since(args.value("since", newest), limit));
  };
  verbs_["incidents"] = [this](const ReplyTo& to, const Json&) { reply_(to, parts_.incidents.list()); };
  verbs_["incident"] = [this](const ReplyTo& to, const Json& args) {
    if (args.contains("id") && !args["id"].is_number_unsigned())
      return reply_(to, Refusal{"usage", fmt::format("'{}' is no number of an incident", args["id"].dump()),
                                "incidents lists them, from 1"});
    reply_(to, parts_.incidents.show(args.value("id", std::uint64_t{0})));
  };
  verbs_["params"] = [this](const ReplyTo& to, const Json&) { reply_(to, params_json(parts_.spine)); };
  verbs_["law_list"] = [this](const ReplyTo& to, const Json&) {
    Json resident = resident_json(parts_.spine);
    for (Json& law : resident) {
      law["score"] = parts_.swaps.score_of(law["law_id"]);
      put_source(law);
    }
    reply_(to, Json{{"resident", std::move(resident)}});
  };
}

void Verbs::add_commands() {
  verbs_["arm"] = [this](const ReplyTo& to, const Json& args) { arm(to, args); };
  const std::pair<const char*, wire::CommandKind> plain[] = {{"hold", wire::CommandKind::hold},
                                                             {"estop", wire::CommandKind::estop},
                                                             {"reset", wire::CommandKind::reset},
                                                             {"recover", wire::CommandKind::recover},
                                                             {"sim_reset", wire::CommandKind::sim_reset}};
  for (const auto& [name, kind] : plain)
    verbs_[name] = [this, kind = kind](const ReplyTo& to, const Json&) { command(kind, to); };
  verbs_["disarm"] = [this](const ReplyTo& to, const Json& args) {
    command(wire::CommandKind::disarm, to, args.value("now", false) ? 1 : 0);
  };
  verbs_["rollback"] = [this](const ReplyTo& to, const Json& args) { roll_back(to, args); };
  verbs_["activate"] = [this](const ReplyTo& to, const Json& args) { activate(to, args); };
  verbs_["revert_params"] = [this](const ReplyTo& to, const Json&) {
    command(wire::CommandKind::revert_params, to, 0, [this](const Json&) { return params_json(parts_.spine); });
  };
  verbs_["set_params"] = [this](const ReplyTo& to, const Json& args) { set_params(to, args); };
  verbs_["shutdown"] = [this](const ReplyTo& to, const Json&) {
    reply_(to, Json{{"stopping", true}, {"pid", ::getpid()}});
    shutdown_();
  };
}

void Verbs::add_swaps() {
  verbs_["swap"] = [this](const ReplyTo& to, const Json& args) { swap_law(to, args); };
  verbs_["law_check"] = [this](const ReplyTo& to, const Json& args) { check_law(to, args); };
}

void Verbs::handle(const ReplyTo& to, const std::string& verb, const Json& args) {
  const auto found = verbs_.find(verb);
  if (found == verbs_.end()) {
    return reply_(to, Refusal{"unknown_verb", fmt::format("there is no verb '{}'", verb),
                              fmt::format("one of: {}", fmt::join(std::views::keys(verbs_), ", "))});
  }
  try {
    found->second(to, args);
  } catch (const Refusal& refusal) {
    reply_(to, refusal);
  }
}

void Verbs::command(wire::CommandKind kind, const ReplyTo& to, std::uint32_t count, const Done& done,
                    std::uint32_t law_id) {
  if (kind == wire::CommandKind::estop)
    parts_.spine.press_estop();  // effective even when the command after it is lost or refused
  else if (kind == wire::CommandKind::reset)
    parts_.spine.release_estop();
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(kind);
  command.count = count;
  command.law_id = law_id;
  parts_.commands.send(command, later(to, done), monotonic_ns());
}

// A refusal because of the law's mark names that law and the one before it.
void Verbs::arm(const ReplyTo& to, const Json& args) {
  const Json anyway = args.value("all_the_same", Json(false));
  if (!anyway.is_boolean())
    throw Refusal{"usage", fmt::format("all_the_same = {} is not true or false", anyway.dump()),
                  "true arms also a law that has stopped the robot; leave it out otherwise"};
  const auto answer = [this, to](const Answer& told) {
    const auto* refusal = std::get_if<Refusal>(&told);
    const auto law = parts_.spine.running_law();
    if (refusal == nullptr || refusal->code != to_string(wire::CommandResult::refused_marked) || !law)
      return reply_(to, told);
    reply_(to, Refusal{refusal->code, fmt::format("cannot arm: law {} has stopped the robot", text_of(law->info.name)),
                       way_from(law->info.law_id, parts_.spine)});
  };
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(wire::CommandKind::arm);
  command.count = anyway == true ? 1 : 0;
  parts_.commands.send(command, answer, monotonic_ns());
}

void Verbs::roll_back(const ReplyTo& to, const Json& args) {
  const Json steps = args.value("steps", Json(1));
  if (!steps.is_number_integer() || steps < 1 || steps > kMostSteps) {
    throw Refusal{"usage", fmt::format("steps = {}: how many laws back, 1 to {}", steps.dump(), kMostSteps),
                  "see which are still there: lithe law list"};
  }
  go_back(to, steps.get<std::uint32_t>(), law_that_runs());
}

// Laws before the running one have smaller numbers, and those that a rollback passed over are gone.
void Verbs::activate(const ReplyTo& to, const Json& args) {
  const Json wanted = args.value("law", Json(nullptr));
  const bool by_id = wanted.is_number_unsigned();
  if (!wanted.is_string() && !by_id)
    throw Refusal{"usage", fmt::format("law = {}: the name of a law, or its law_id", wanted.dump()),
                  "lithe law list has them"};
  const std::string name = by_id ? "" : wanted.get<std::string>();
  const auto is_wanted = [&](const wire::LawInfo& law) {
    return by_id ? law.law_id == wanted.get<std::uint64_t>() : text_of(law.name) == name;
  };
  const auto running = parts_.spine.running_law();
  const std::uint32_t now = running ? running->info.law_id : 0;
  if (running && is_wanted(running->info)) return reply_(to, law_that_runs());
  std::vector<wire::LawInfo> earlier = parts_.spine.laws();
  std::erase_if(earlier, [now](const wire::LawInfo& law) { return law.law_id >= now; });
  const auto found = std::find_if(earlier.rbegin(), earlier.rend(), is_wanted);
  if (found == earlier.rend()) {
    if (const auto text = parts_.swaps.source_of(name); !text.empty()) {
      const std::string document = fmt::format("swaps/{}", text.filename().string());
      throw Refusal{
          "unknown_law",
          fmt::format("law '{}' is no longer loaded: a rollback passed over it, or later laws took its place", name),
          fmt::format("swap it in again, from the document {} or {}", document, text.string()),
          {{"source", document}}};
    }
    std::set<std::string> names;
    for (const wire::LawInfo& law : earlier) names.insert(fmt::format("'{}'", text_of(law.name)));
    throw Refusal{
        "unknown_law",
        fmt::format("no law {} ran before this one and is still loaded",
                    by_id ? wanted.dump() : fmt::format("'{}'", name)),
        fmt::format("{}swap its text", names.empty() ? "" : fmt::format("one of {}, or ", fmt::join(names, ", ")))};
  }
  go_back(to, static_cast<std::uint32_t>(found - earlier.rbegin()) + 1, in_short(running));
}

// The document that has its text, where it is kept.
void Verbs::put_source(Json& law) const {
  if (const auto text = parts_.swaps.source_of(law["law_id"].get<std::uint32_t>()); !text.empty())
    law["source"] = fmt::format("swaps/{}", text.filename().string());
}

Json Verbs::law_that_runs() const { return in_short(parts_.spine.running_law()); }

// The law that runs after it, the one that it left, and the laws that are gone with that: no rollback leads to them.
// The steps are counted from `left`: the Spine refuses them when it has gone back by itself meanwhile.
void Verbs::go_back(const ReplyTo& to, std::uint32_t steps, const Json& left) {
  Json known = Json::array();
  for (const wire::LawInfo& law : parts_.spine.laws()) {
    if (law.law_id > left["law_id"].get<std::uint32_t>()) continue;  // a candidate
    Json told = {{"law", text_of(law.name)}, {"law_id", law.law_id}};
    put_source(told);
    known.insert(known.begin(), std::move(told));
  }
  const auto answer = [this, left, known](Json json) {
    json.update(law_that_runs());
    json["left"] = left;
    json["dropped"] = Json::array();
    for (const Json& law : known)
      if (law["law_id"] > json["law_id"]) json["dropped"].push_back(law);
    return json;
  };
  command(wire::CommandKind::rollback, to, steps, answer, left["law_id"].get<std::uint32_t>());
}

void Verbs::set_params(const ReplyTo& to, const Json& args) {
  Json values = args.value("values", Json::object());
  if (args.contains("name")) values[args["name"].get<std::string>()] = args.value("value", Json(nullptr));
  const Done params_of = [this](const Json& done) {
    Answer out = params_json(parts_.spine);
    if (Json* params = std::get_if<Json>(&out)) params->update(done);
    return out;
  };
  parts_.swaps.set_params(values, args.value("dry_run", false), later(to, params_of), monotonic_ns());
}

void Verbs::swap_law(const ReplyTo& to, const Json& args) {
  SwapRequest request = read_request(args);
  request.terms = value_of(parts_.swaps.read_terms(args));
  request.client = to.client;
  request.supersede = args.value("supersede", false);
  request.dry_run = args.value("dry_run", false);
  parts_.swaps.submit(std::move(request), later(to), monotonic_ns());
}

void Verbs::check_law(const ReplyTo& to, const Json& args) {
  const SwapRequest law = read_request(args);
  parts_.lawd.check({law.name, law.source}, later(to), monotonic_ns());
}

}  // namespace lithe::control
