// SPDX-License-Identifier: Apache-2.0
// What the Spine says about swaps: its events, and shared memory where an event was lost.
#include <fmt/format.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "spine/core/time.hpp"
#include "supervisor/swap/swaps.hpp"

namespace lithe::control {
namespace {

constexpr std::int64_t kWordsGraceNs = 50'000'000;  // for the event of what shared memory shows already

// The field names in the event. The text may hold only some of them; `count` is the full number.
Json not_carried_json(const wire::Event& event) {
  const std::string text = text_of(event.text);  // "a, b: why"
  const std::size_t end = text.find(": ");
  Json fields = Json::array();
  for (std::size_t at = 0; at < std::min(end, text.size());) {
    const std::size_t comma = std::min({text.find(", ", at), end, text.size()});
    fields.push_back(text.substr(at, comma - at));
    at = comma + 2;
  }
  return {{"tick", event.tick},
          {"count", event.value},
          {"fields", std::move(fields)},
          {"why", end == std::string::npos ? "" : text.substr(end + 2)}};
}

Json shadow_json(const wire::ShadowReport& report) {
  const std::size_t joints = std::min<std::size_t>(report.joint_count, wire::kNj);
  return {{"from_tick", report.from_tick},
          {"ticks", report.ticks},
          {"faults", report.faults},
          {"most_ns", report.most_ns},
          {"mean_ns", report.mean_ns},
          {"most_nm", std::vector<double>(report.most_nm.begin(), report.most_nm.begin() + joints)},
          {"rms_nm", std::vector<double>(report.rms_nm.begin(), report.rms_nm.begin() + joints)}};
}

}  // namespace

Refusal stage_refusal(wire::StageResult result, const std::string& words) {
  const std::string code(to_string(result));
  const char* next = result == wire::StageResult::busy || result == wire::StageResult::slots_full
                         ? "another swap is under way in the Spine; try again"
                         : "the running law is unchanged; lithe law check tells more";
  return {code, words.empty() ? fmt::format("the Loader refused the law: {}", code) : words, next};
}

void Swaps::on_event(const wire::Event& event, std::int64_t now_ns) {
  const auto kind = static_cast<wire::EventKind>(event.kind);
  if (kind == wire::EventKind::state_not_carried) return not_carried(event);
  if (heard_.commit && kind != wire::EventKind::law_committed) {
    heard_.shown = true;  // this event may be about the committed law
    go_on(now_ns);
  }
  lifecycle_.on_event(event);
  params_.on_event(event);
  if (kind == wire::EventKind::law_retired) tried_laws_.forget(event.request_id);
  if (is_head(event.request_id)) {
    hear(event);
    go_on(now_ns);
  } else {
    come_late(event);
  }
}

void Swaps::hear(const wire::Event& event) {
  switch (static_cast<wire::EventKind>(event.kind)) {
    case wire::EventKind::law_staged:
      heard_.staged_ns = event.t_ns;
      return;
    case wire::EventKind::shadow_started:
      heard_.shadow_ns = event.t_ns;
      return;
    case wire::EventKind::shadow_ended:
      return shadow_ended(event);
    case wire::EventKind::law_committed:
      heard_.commit = event;
      return;
    case wire::EventKind::law_refused:
      heard_.refusal = stage_refusal(static_cast<wire::StageResult>(event.code), text_of(event.text));
      return;
    default:
      return;
  }
}

void Swaps::shadow_ended(const wire::Event& event) {
  wire::ShadowReport report{};
  ipc::ChannelReader<wire::ShadowReport> reader(help_.spine.memory().shadow);
  if (reader.read(report) && report.request_id == event.request_id) head_->swap.note("shadow", shadow_json(report));
  if (event.code == 2) heard_.measured = event;
  if (event.code == 0) {
    heard_.refusal =
        Refusal{"shadow_failed",
                fmt::format("in the shadow: {} (largest difference {:.4g} N m, tolerance {:.4g} N m)",
                            text_of(event.text), event.value, head_->swap.request().terms.shadow_tolerance_nm),
                "the running law is unchanged; make them agree, or swap without a shadow"};
  }
}

// The stages that the Spine told of: the tick may commit before the Loader's acknowledgement is read.
void Swaps::mark_heard(SwapState& swap) const {
  const std::int64_t later_ns = heard_.shadow_ns != 0 ? heard_.shadow_ns : heard_.commit ? heard_.commit->t_ns : 0;
  swap.mark(Stage::staged, "", heard_.staged_ns != 0 ? heard_.staged_ns : later_ns);
  if (heard_.shadow_ns != 0) swap.mark(Stage::shadow, "", heard_.shadow_ns);
}

// What shared memory shows of the head's law, which the Spine has.
void Swaps::look(std::int64_t now_ns) {
  const std::int64_t since_ns = head_->swap.stage_since_ns();
  if (heard_.commit) {
    const wire::Telemetry now = help_.spine.now();
    heard_.shown = heard_.shown || now.tick > heard_.commit->tick || now_ns - heard_.commit->t_ns > kWordsGraceNs;
  } else if (heard_.stage() != Stage::tried) {
    heard_.shown = now_ns - since_ns > kWordsGraceNs && find_commit(now_ns);
  } else if (const auto result = help_.spine.poll_stage(heard_.ticket); result == wire::StageResult::staged) {
    heard_.staged_ns = now_ns - since_ns > kWordsGraceNs ? now_ns : 0;
  } else if (result != wire::StageResult::pending) {
    heard_.refused_ns = heard_.refused_ns == 0 ? now_ns : heard_.refused_ns;
    if (now_ns - heard_.refused_ns > kWordsGraceNs) heard_.refusal = stage_refusal(result, "");
  }
}

// The commit is normally known from its event. When the ring lost the event, the law id in telemetry shows it; the
// commit tick is then an estimate.
bool Swaps::find_commit(std::int64_t now_ns) {
  wire::Telemetry now{};
  if (heard_.commit || !help_.spine.latest(now)) return heard_.commit.has_value();
  const auto law = help_.spine.law(now.law_id);
  if (!law || law->request_id != head_->swap.request_id()) return false;
  head_->swap.note("commit_tick_is_estimate", true);
  heard_.commit.emplace();
  heard_.commit->tick = now.tick;
  heard_.commit->code = now.law_id;
  heard_.commit->t_ns = now_ns;
  return heard_.shown = true;
}

std::deque<Swaps::Entry>::iterator Swaps::given_up(std::uint64_t request_id) {
  return std::ranges::find_if(unconfirmed_, [&](const Entry& each) { return each.swap.request_id() == request_id; });
}

// A swap that timed out, and whose outcome the Spine reports later.
void Swaps::come_late(const wire::Event& event) {
  const auto found = given_up(event.request_id);
  const auto kind = static_cast<wire::EventKind>(event.kind);
  const bool committed = kind == wire::EventKind::law_committed;
  if (found == unconfirmed_.end() || (!committed && kind != wire::EventKind::law_refused)) return;
  Entry late = std::move(*found);
  SwapState& swap = late.swap;
  unconfirmed_.erase(found);
  if (!committed) {
    swap.mark_refused(stage_refusal(static_cast<wire::StageResult>(event.code), text_of(event.text)), event.t_ns);
    tried_laws_.forget(swap.request_id());
    note(swap, "swap_refused", fmt::format("{}: after it was given up", swap.request().name));
    return rewrite(swap, late.record);
  }
  swap.mark_committed(event.tick, event.code, event.t_ns);
  swap.note_missed_after(missed_releases());
  note(swap, "swap_committed_late", fmt::format("{}: it was given up, and runs now", swap.request().name));
  rewrite(swap, late.record);
  lifecycle_.follow(std::move(swap), late.record, {}, monotonic_ns());  // without counts: other swaps came in between
}

// Writes into answer and certificate which State fields start from their defaults.
void Swaps::not_carried(const wire::Event& event) {
  const Json what = not_carried_json(event);
  if (is_head(event.request_id))
    head_->swap.note("state_not_carried", what);
  else if (const auto late = given_up(event.request_id); late != unconfirmed_.end())
    late->swap.note("state_not_carried", what);
  else
    lifecycle_.note(event.request_id, "state_not_carried", what);
}

}  // namespace lithe::control
