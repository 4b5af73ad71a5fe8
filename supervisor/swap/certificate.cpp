// SPDX-License-Identifier: Apache-2.0
// Writes a transaction as its certificate (JSON).
#include <utility>

#include "spine/core/sha256.hpp"
#include "supervisor/swap/transaction.hpp"

namespace lithe::swap {
namespace {

double ms(std::int64_t duration_ns) { return static_cast<double>(duration_ns) * 1e-6; }

}  // namespace

const char* Transaction::verdict() const {
  if (refusal_) {
    return outcome_is_known() ? "refused" : "not_confirmed";
  }
  for (const Stage each : {Stage::rolled_back, Stage::confirmed, Stage::unproven, Stage::committed}) {
    if (reached(each)) {
      return to_string(each);
    }
  }
  return to_string(Stage::submitted);
}

double Transaction::ms_between(Stage from, Stage to) const {
  return reached(from) && reached(to) ? ms(time_of(to) - time_of(from)) : 0.0;
}

// Duration of each stage, from the end of the stage before it.
Json Transaction::split_ms() const {
  Json split = Json::object();
  if (started_ns_ == 0) {
    return split;
  }
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

Json Transaction::times_ns() const {
  Json times = {{"submitted", steps_.front().t_ns}};
  if (started_ns_ != 0) {
    times["started"] = started_ns_;
  }
  for (std::size_t i = 1; i < steps_.size(); ++i) {
    times[steps_[i].stage == Stage::refused ? verdict() : to_string(steps_[i].stage)] = steps_[i].t_ns;
  }
  return times;
}

Json Transaction::certificate() const {
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
  for (const Step& each : steps_) {
    if (!each.reason.empty()) {
      reasons[to_string(each.stage)] = each.reason;
    }
  }
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

}  // namespace lithe::swap
