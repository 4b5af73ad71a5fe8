// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/transaction.hpp"

#include <algorithm>
#include <utility>

namespace lithe::swap {
namespace {

bool may_follow(Stage from, Stage to) {
  switch (to) {
    case Stage::submitted:
      return false;
    case Stage::refused:
      return from < Stage::committed;
    case Stage::committed:
      return from == Stage::staged || from == Stage::shadow;
    case Stage::confirmed:
      return from == Stage::committed || from == Stage::unproven;
    case Stage::rolled_back:
      return from >= Stage::committed && from <= Stage::confirmed;
    case Stage::retired:
      return from >= Stage::committed && from <= Stage::rolled_back;
    default:  // each after the one before it
      return static_cast<int>(to) == static_cast<int>(from) + 1;
  }
}

}  // namespace

const char* to_string(Stage stage) {
  static constexpr const char* kWords[] = {"submitted",   "compiled", "admitted",  "placed",   "tried",
                                           "staged",      "shadow",   "committed", "unproven", "confirmed",
                                           "rolled_back", "retired",  "refused"};
  return kWords[static_cast<std::size_t>(stage)];
}

Transaction::Transaction(std::uint64_t request_id, Request request, std::int64_t now_ns)
    : request_id_(request_id),
      request_(std::move(request)),
      steps_{{Stage::submitted, now_ns, ""}},
      stage_since_ns_(now_ns) {}

bool Transaction::enter(Stage stage, const std::string& reason, std::int64_t now_ns) {
  if (started_ns_ == 0 ? stage != Stage::refused || finished() : !may_follow(this->stage(), stage)) {
    return false;
  }
  stage_since_ns_ = std::max(now_ns, stage_since_ns_);
  steps_.push_back({stage, stage_since_ns_, reason});
  return true;
}

bool Transaction::mark_started(std::int64_t now_ns) {
  if (stage() != Stage::submitted || started_ns_ != 0) {
    return false;
  }
  started_ns_ = std::max(now_ns, stage_since_ns_);
  stage_since_ns_ = started_ns_;
  return true;
}

bool Transaction::mark_compiled(Compiled compiled, std::int64_t now_ns) {
  if (!enter(Stage::compiled, compiled.cached ? "cached" : "", now_ns)) {
    return false;
  }
  compiled_ = std::move(compiled);
  return true;
}

bool Transaction::mark(Stage stage, const std::string& reason, std::int64_t now_ns) {
  const bool brings_more = stage == Stage::compiled || stage == Stage::committed || stage == Stage::refused;
  return !brings_more && enter(stage, reason, now_ns);
}

bool Transaction::mark_committed(std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns) {
  if (!outcome_is_known()) {
    reopen();
    enter(Stage::staged, "", now_ns);  // unless this was reported before
  }
  if (!enter(Stage::committed, "", now_ns)) {
    return false;
  }
  commit_tick_ = tick;
  law_id_ = law_id;
  return true;
}

bool Transaction::mark_refused(Refusal reason, std::int64_t now_ns) {
  if (!outcome_is_known()) {
    reopen();
  }
  if (!enter(Stage::refused, reason.code, now_ns)) {
    return false;
  }
  refusal_ = std::move(reason);
  return true;
}

bool Transaction::mark_given_up(Refusal reason, std::int64_t now_ns) {
  if (refusal_ || !mark_refused(std::move(reason), now_ns)) {
    return false;
  }
  given_up_ = true;
  return true;
}

// The Spine reports later. The answer that the client got is kept.
void Transaction::reopen() {
  note("answered", {{"verdict", verdict()}, {"t_ns", steps_.back().t_ns}, {"error", refusal_->to_json()}});
  steps_.pop_back();
  stage_since_ns_ = steps_.back().t_ns;
  refusal_.reset();
  given_up_ = false;
}

// From stage `tried` on the request is with the Loader.
bool Transaction::outcome_is_known() const { return !given_up_ || !reached(Stage::tried); }

std::int64_t Transaction::time_of(Stage stage) const {
  const auto found = std::find_if(steps_.begin(), steps_.end(), [&](const Step& each) { return each.stage == stage; });
  return found == steps_.end() ? 0 : found->t_ns;
}

}  // namespace lithe::swap
