// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/certificate/swap_state.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>

#include "spine/core/sha256.hpp"

namespace lithe::control {
namespace {

bool may_follow(Stage from, Stage to) {
  switch (to) {
    case Stage::submitted:
      return false;
    case Stage::refused:
      return from < Stage::committed;
    case Stage::committed:
      return from == Stage::staged || from == Stage::shadow;
    case Stage::measured:
      return from == Stage::shadow;
    case Stage::unproven:
      return from == Stage::committed || from == Stage::rolled_back;
    case Stage::confirmed:  // also after a stop without a law to go back to: it runs again after the reset
      return from == Stage::committed || from == Stage::unproven || from == Stage::rolled_back;
    case Stage::rolled_back:
      return from >= Stage::committed && from <= Stage::confirmed;
    case Stage::retired:
      return from >= Stage::committed && from <= Stage::rolled_back;
    default:  // each after the one before it
      return static_cast<int>(to) == static_cast<int>(from) + 1;
  }
}

double ms(std::int64_t duration_ns) { return static_cast<double>(duration_ns) * 1e-6; }

// On which side of the robot file's value a term judges a law less strictly.
enum class Looser { no, below, above };

struct Argument {
  const char* name;
  double SwapTerms::* field;
  double least, most;
  bool or_zero;  // 0 switches it off, whatever `least` says
  const char* what;
  Looser looser = Looser::no;
};

constexpr double kTickLimit = std::numeric_limits<double>::infinity();  // as long as one tick

constexpr Argument kArguments[] = {
    {"blend_s", &SwapTerms::blend_s, 0.0, 5.0, true, "from the old law's torque to the new one's"},
    {"probation_s", &SwapTerms::probation_s, 0.0, 60.0, true, "automatic rollback for so long, 0 = none",
     Looser::below},
    {"error_ratio", &SwapTerms::error_ratio, 1.0, 1e6, true,
     "roll back when tracking gets so many times worse, 0 = never", Looser::above},
    {"shadow_s", &SwapTerms::shadow_s, 0.0, 60.0, true, "beside the active law first, 0 = no shadow"},
    {"shadow_tolerance_nm", &SwapTerms::shadow_tolerance_nm, 1e-9, 1e6, false, "largest difference that is agreement"},
    {"budget_us", &SwapTerms::budget_us, 1.0, kTickLimit, false, "of one step", Looser::above},
    {"box_ms", &SwapTerms::box_ms, 20.0, 5000.0, false, "processor time of the trial"},
};

constexpr const char* kPromote = "promote";

// An agent keeps to the robot file's fences. 0 is the loosest: "none", "never".
std::optional<Refusal> beyond_fence(const Argument& each, double value, double robots) {
  const bool is_off = each.or_zero && value == 0.0, robots_is_off = each.or_zero && robots == 0.0;
  const bool looser = each.looser == Looser::below   ? value < robots
                      : each.looser == Looser::above ? !robots_is_off && (is_off || value > robots)
                                                     : false;
  if (!looser) return std::nullopt;
  return Refusal{"no_permission",
                 fmt::format("{} = {:g} is looser than the robot file's {:g} ({}): only a person may set that",
                             each.name, value, robots, each.what),
                 fmt::format("the running law is unchanged; leave {} out, or give {} {:g}", each.name,
                             each.looser == Looser::below ? "at least" : "at most", robots)};
}

std::uint32_t ticks(double seconds, double rate_hz) {
  return seconds > 0 ? static_cast<std::uint32_t>(std::max(1.0, std::round(seconds * rate_hz))) : 0;
}

}  // namespace

Json SwapTerms::to_json() const {
  Json out = Json::object();
  for (const Argument& each : kArguments) out[each.name] = this->*each.field;
  out["promote"] = promote;
  return out;
}

SwapTerms terms_of(const robot::RobotConfig& robot, double rate_hz) {
  SwapTerms terms;
  terms.blend_s = robot.swap.blend_s;
  terms.probation_s = robot.swap.probation_s;
  terms.error_ratio = robot.swap.probation_error_ratio;
  terms.budget_us = robot.swap.budget_share * 1e6 / rate_hz;
  double weakest_nm = robot.joints.empty() ? 1.0 : robot.joints.front().torque_max_nm;
  for (const robot::JointConfig& joint : robot.joints) weakest_nm = std::min(weakest_nm, joint.torque_max_nm);
  terms.shadow_tolerance_nm = 0.1 * weakest_nm;
  return terms;
}

bool is_term(const std::string& argument) {
  return argument == kPromote ||
         std::ranges::any_of(kArguments, [&](const Argument& each) { return argument == each.name; });
}

std::variant<SwapTerms, Refusal> read_terms(const Json& args, const SwapTerms& robot, double rate_hz) {
  SwapTerms terms = robot;
  for (const Argument& each : kArguments) {
    const auto found = args.find(each.name);
    if (found == args.end() || found->is_null()) continue;
    const double most = std::min(each.most, each.most == kTickLimit ? 1e6 / rate_hz : each.most);
    const double value = found->is_number() ? found->get<double>() : std::nan("");
    const bool in_range = value >= each.least && value <= most;
    if (!in_range && !(each.or_zero && value == 0.0)) {
      return Refusal{"usage",
                     fmt::format("{} = {} is not {}a number from {:g} to {:g} ({})", each.name, found->dump(),
                                 each.or_zero ? "0 or " : "", each.least, most, each.what),
                     "the running law is unchanged; leave it out to use the robot file's value"};
    }
    if (args.value("fenced", false))
      if (auto refusal = beyond_fence(each, value, robot.*each.field)) return *refusal;
    terms.*each.field = value;
  }
  const Json promote = args.value(kPromote, Json());
  if (!promote.is_null() && !promote.is_boolean()) {
    return Refusal{"usage", fmt::format("promote = {} is not true or false", promote.dump()),
                   "the running law is unchanged; false: the law is only compared with the running one, for shadow_s"};
  }
  terms.promote = promote != false;
  if (!terms.promote && terms.shadow_s == 0) {
    return Refusal{"usage", "promote = false compares the law with the running one, and shadow_s says for how long",
                   "the running law is unchanged; give shadow_s, such as 2"};
  }
  return terms;
}

void put_terms(const SwapTerms& terms, double rate_hz, wire::StageRequest& request) {
  request.budget_ns = terms.budget_ns();
  request.shadow_only = terms.promote ? 0 : 1;
  request.shadow_ticks = ticks(terms.shadow_s, rate_hz);
  request.blend_ticks = ticks(terms.blend_s, rate_hz);
  request.probation_ticks = ticks(terms.probation_s, rate_hz);
  request.shadow_tolerance_nm = terms.shadow_tolerance_nm;
  request.probation_error_ratio = terms.error_ratio;
}

Compiled compiled_of(const Json& answer) {
  Compiled compiled;
  compiled.object = answer.value("object", "");
  compiled.hash = answer.value("hash", "");
  compiled.descriptor = answer.value("law", Json::object());
  compiled.law = compiled.descriptor.value("name", "");
  compiled.cached = answer.value("cached", false);
  compiled.compile_ms = answer.value("compile_ms", 0.0);
  double ms = 0.0;  // a law from the cache was admitted earlier
  if (!compiled.cached)
    for (const Json& gate : answer.value("gates", Json::array())) ms += gate.value("ms", 0.0);
  compiled.admission_ns = static_cast<std::int64_t>(ms * 1e6);
  for (const char* key : {"object_sha256", "placeable_sha256", "toolchain", "gates", "steps_ms", "dry_step_max_ns",
                          "warnings", "cleaned"}) {
    if (answer.contains(key)) compiled.facts[key] = answer[key];
  }
  return compiled;
}

const char* to_string(Stage stage) {
  static constexpr const char* kWords[] = {"submitted",   "compiled", "admitted",  "placed",   "tried",
                                           "staged",      "shadow",   "committed", "unproven", "confirmed",
                                           "rolled_back", "retired",  "refused",   "measured"};
  return kWords[static_cast<std::size_t>(stage)];
}

SwapState::SwapState(std::uint64_t request_id, SwapRequest request, std::int64_t now_ns)
    : request_id_(request_id),
      request_(std::move(request)),
      steps_{{Stage::submitted, now_ns, ""}},
      stage_since_ns_(now_ns) {}

bool SwapState::enter(Stage stage, const std::string& reason, std::int64_t now_ns) {
  if (started_ns_ == 0 ? stage != Stage::refused || finished() : !may_follow(this->stage(), stage)) return false;
  stage_since_ns_ = std::max(now_ns, stage_since_ns_);
  steps_.push_back({stage, stage_since_ns_, reason});
  return true;
}

bool SwapState::mark_started(std::int64_t now_ns) {
  if (stage() != Stage::submitted || started_ns_ != 0) return false;
  started_ns_ = std::max(now_ns, stage_since_ns_);
  stage_since_ns_ = started_ns_;
  return true;
}

bool SwapState::mark_compiled(Compiled compiled, std::int64_t now_ns) {
  if (!enter(Stage::compiled, compiled.cached ? "cached" : "", now_ns)) return false;
  compiled_ = std::move(compiled);
  return true;
}

bool SwapState::mark(Stage stage, const std::string& reason, std::int64_t now_ns) {
  const bool brings_more = stage == Stage::compiled || stage == Stage::committed || stage == Stage::refused;
  return !brings_more && enter(stage, reason, now_ns);
}

bool SwapState::mark_committed(std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns) {
  if (!outcome_is_known()) {
    reopen();
    enter(Stage::staged, "", now_ns);  // unless this was reported before
  }
  if (!enter(Stage::committed, "", now_ns)) return false;
  commit_tick_ = tick;
  law_id_ = law_id;
  return true;
}

bool SwapState::mark_refused(Refusal reason, std::int64_t now_ns) {
  if (!outcome_is_known()) reopen();
  if (!enter(Stage::refused, reason.code, now_ns)) return false;
  refusal_ = std::move(reason);
  return true;
}

bool SwapState::mark_given_up(Refusal reason, std::int64_t now_ns) {
  if (refusal_ || !mark_refused(std::move(reason), now_ns)) return false;
  given_up_ = true;
  return true;
}

// The Spine reports later. The answer that the client got is kept.
void SwapState::reopen() {
  note("answered", {{"verdict", verdict()}, {"t_ns", steps_.back().t_ns}, {"error", refusal_->to_json()}});
  steps_.pop_back();
  stage_since_ns_ = steps_.back().t_ns;
  refusal_.reset();
  given_up_ = false;
}

// From stage `tried` on the request is with the Loader.
bool SwapState::outcome_is_known() const { return !given_up_ || !reached(Stage::tried); }

std::int64_t SwapState::time_of(Stage stage) const {
  const auto found = std::ranges::find_if(steps_, [&](const Step& each) { return each.stage == stage; });
  return found == steps_.end() ? 0 : found->t_ns;
}

const char* SwapState::verdict() const {
  if (refusal_) return outcome_is_known() ? "refused" : "not_confirmed";
  for (auto step = steps_.rbegin(); step != steps_.rend(); ++step) {
    switch (step->stage) {
      case Stage::measured:
      case Stage::rolled_back:
      case Stage::confirmed:
      case Stage::unproven:
      case Stage::committed:
        return to_string(step->stage);
      default:  // on its way, or gone
        break;
    }
  }
  return to_string(Stage::submitted);
}

double SwapState::ms_between(Stage from, Stage to) const {
  return reached(from) && reached(to) ? ms(time_of(to) - time_of(from)) : 0.0;
}

// Duration of each stage, from the end of the stage before it.
Json SwapState::split_ms() const {
  Json split = Json::object();
  if (started_ns_ == 0) return split;
  split["queued"] = ms(started_ns_ - steps_.front().t_ns);
  std::int64_t before_ns = started_ns_;
  for (const Step& each : steps_) {
    if (each.stage != Stage::submitted && each.stage <= Stage::committed) {
      split[to_string(each.stage)] = ms(each.t_ns - before_ns);
      before_ns = each.t_ns;
    }
  }
  return split;
}

Json SwapState::times_ns() const {
  Json times = {{"submitted", steps_.front().t_ns}};
  if (started_ns_ != 0) times["started"] = started_ns_;
  for (std::size_t i = 1; i < steps_.size(); ++i)
    times[steps_[i].stage == Stage::refused ? verdict() : to_string(steps_[i].stage)] = steps_[i].t_ns;
  return times;
}

Json SwapState::certificate() const {
  Json out;
  out["request_id"] = request_id_;
  out["verdict"] = verdict();
  out["stage"] = to_string(stage());
  out["law"] = compiled_.law;
  out["source"] = request_.name;
  out["source_sha256"] = sha256_hex(request_.source);
  out["hash"] = compiled_.hash;
  out["cached"] = compiled_.cached;
  out["compile_ms"] = compiled_.compile_ms;
  if (law_id_ != 0) {
    out["law_id"] = law_id_;
    out["commit_tick"] = commit_tick_;
    out["load_ms"] = ms_between(Stage::admitted, Stage::placed) + ms_between(Stage::tried, Stage::staged);
    out["requested_to_committed_ms"] = ms_between(Stage::submitted, Stage::committed);
    out["missed_releases"] = missed_after_ - missed_before_;
  }
  out["split_ms"] = split_ms();
  out["times_ns"] = times_ns();
  Json reasons = Json::object();
  for (const Step& each : steps_)  // why it was unproven holds only as long as it is
    if (!each.reason.empty() && (each.stage != Stage::unproven || verdict() == std::string_view("unproven")))
      reasons[to_string(each.stage)] = each.reason;
  out["reasons"] = std::move(reasons);
  out["terms"] = request_.terms.to_json();
  if (!request_.params.empty()) {
    // Parameters are taken together with their law; null = not known yet.
    const bool known = law_id_ != 0 || (refusal_ && outcome_is_known());
    out["params"] = {{"values", request_.params}, {"taken", known ? Json(law_id_ != 0) : Json()}};
  }
  out.update(compiled_.facts);
  out.update(sections_);
  if (refusal_) {
    out["refused_after"] = to_string(steps_[steps_.size() - 2].stage);
    out["error"] = refusal_->to_json();
  }
  return out;
}

Json summary_of(const Json& certificate) {
  Json out = Json::object();
  for (const char* key :
       {"request_id", "law", "source", "verdict", "commit_tick", "requested_to_committed_ms", "refused_after"}) {
    if (certificate.contains(key)) out[key] = certificate[key];
  }
  if (certificate.contains("state_not_carried")) out["state_not_carried"] = certificate["state_not_carried"]["fields"];
  if (const Json trial = certificate.value("trial", Json::object()); !trial.value("warnings", Json::array()).empty())
    out["warnings"] = trial["warnings"];
  // Old law beside new; the certificate has the rest.
  if (const Json control = certificate.value("control", Json::object()); !control.empty()) {
    for (const Json& joint : control.value("joints", Json::array())) {
      Json rms = Json::array();
      for (const char* side : {"before", "after"})
        rms.push_back(joint[side].is_object() ? joint[side]["rms_error_rad"] : Json(nullptr));
      out["rms_error_rad"][joint.value("joint", "?")] = std::move(rms);
    }
  }
  if (certificate.contains("cleaned")) out["cleaned"] = certificate["cleaned"];
  const Json reasons = certificate.value("reasons", Json::object());
  if (certificate.contains("error"))
    out["reason"] = certificate["error"].value("message", "");
  else if (reasons.contains("rolled_back"))
    out["reason"] = reasons["rolled_back"];
  else if (certificate.value("verdict", "") == "unproven")
    out["reason"] = reasons.value("unproven", "");
  return out;
}

}  // namespace lithe::control
