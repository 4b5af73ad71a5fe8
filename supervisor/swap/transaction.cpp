// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/transaction.hpp"

#include <algorithm>
#include <utility>

namespace lithe::swap {
namespace {

double ms_between(std::int64_t from_ns, std::int64_t to_ns) { return static_cast<double>(to_ns - from_ns) * 1e-6; }

}  // namespace

const char* to_string(Stage stage) {
  switch (stage) {
    case Stage::submitted:
      return "submitted";
    case Stage::compiled:
      return "compiled";
    case Stage::staged:
      return "staged";
    case Stage::committed:
      return "committed";
    case Stage::refused:
      return "refused";
  }
  return "unknown";
}

Transaction::Transaction(std::uint64_t request_id, Request request, std::int64_t now_ns)
    : request_id_(request_id), request_(std::move(request)), submitted_ns_(now_ns), stage_since_ns_(now_ns) {}

void Transaction::enter(Stage stage, std::int64_t now_ns) {
  stage_ = stage;
  stage_since_ns_ = now_ns;
}

bool Transaction::mark_started(std::int64_t now_ns) {
  if (stage_ != Stage::submitted || started_ns_ != 0) {
    return false;
  }
  started_ns_ = now_ns;
  stage_since_ns_ = now_ns;
  return true;
}

bool Transaction::mark_compiled(Compiled compiled, std::int64_t now_ns) {
  if (stage_ != Stage::submitted || started_ns_ == 0) {
    return false;
  }
  compiled_ = std::move(compiled);
  compiled_ns_ = now_ns;
  enter(Stage::compiled, now_ns);
  return true;
}

bool Transaction::mark_staged(std::int64_t now_ns) {
  if (stage_ != Stage::compiled) {
    return false;
  }
  staged_ns_ = std::max(compiled_ns_, now_ns);
  enter(Stage::staged, staged_ns_);
  return true;
}

bool Transaction::mark_committed(std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns) {
  if (stage_ != Stage::staged) {
    return false;
  }
  commit_tick_ = tick;
  law_id_ = law_id;
  finished_ns_ = std::max(staged_ns_, now_ns);
  enter(Stage::committed, finished_ns_);
  return true;
}

bool Transaction::mark_refused(Refusal reason, std::int64_t now_ns) {
  if (finished()) {
    return false;
  }
  refusal_ = std::move(reason);
  refused_in_ = stage_;
  finished_ns_ = now_ns;
  enter(Stage::refused, now_ns);
  return true;
}

bool Transaction::confirmed() const {
  return !refusal_ || refusal_->code != "timeout" || refused_in_ == Stage::submitted;
}

Json Transaction::certificate() const {
  const char* verdict = confirmed() ? to_string(stage_) : "not_confirmed";
  Json out;
  out["request_id"] = request_id_;
  out["verdict"] = verdict;
  out["law"] = compiled_.law;
  out["source"] = request_.name;
  out["hash"] = compiled_.hash;
  out["cached"] = compiled_.cached;
  out["compile_ms"] = compiled_.compile_ms;
  if (stage_ == Stage::committed) {
    out["law_id"] = law_id_;
    out["commit_tick"] = commit_tick_;
    out["load_ms"] = ms_between(compiled_ns_, staged_ns_);
    out["requested_to_committed_ms"] = ms_between(submitted_ns_, finished_ns_);
    out["missed_releases"] = missed_after_ - missed_before_;
  }
  Json times = {{"submitted", submitted_ns_}};
  const std::pair<const char*, std::int64_t> steps[] = {
      {"started", started_ns_}, {"compiled", compiled_ns_}, {"staged", staged_ns_}, {verdict, finished_ns_}};
  for (const auto& [word, t_ns] : steps) {
    if (t_ns != 0) {
      times[word] = t_ns;
    }
  }
  out["times_ns"] = std::move(times);
  if (refusal_) {
    out["refused_after"] = to_string(refused_in_);
    out["error"] = refusal_->to_json();
  }
  return out;
}

}  // namespace lithe::swap
