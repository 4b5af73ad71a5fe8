// SPDX-License-Identifier: Apache-2.0
// Requests, certificates and answers of swaps. The steps are in swap_steps.cpp.
#include "supervisor/swap/swaps.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "spine/core/time.hpp"
#include "supervisor/swap/swap_words.hpp"

namespace lithe::control {

using swap::Answer;
using swap::Json;
using swap::Refusal;

Swaps::Swaps(const Helpers& helpers, swap::RecordBook book, std::uint64_t first_request_id,
             const robot::RobotConfig& robot)
    : help_(helpers),
      placement_(helpers.spine, helpers.lawd),
      book_(std::move(book)),
      robots_terms_(swap::terms_of(robot, helpers.spine.info().rate_hz)),
      queue_({[this](const swap::Transaction& each) { compile(each); },
              [this](const swap::Transaction& each) { place(each); },
              [this](const swap::Transaction& each) { attempt(each); },
              [this](const swap::Transaction& each) { stage(each); }, [this] { return missed_releases(); },
              [this](swap::Transaction&& each) { finish(std::move(each)); }},
             first_request_id, {2 * LawdLink::kCompileTimeoutNs, 2 * LawdLink::kCompileTimeoutNs}),
      lifecycle_(
          helpers.spine,
          [this](const swap::Transaction& each, const swap::RecordBook::Page& record) { rewrite(each, record); },
          [this](const swap::Transaction& each, std::uint32_t offset, LawLifecycle::Found found) {
            locate(each, offset, std::move(found));
          }),
      tried_laws_(helpers.spine),
      params_({helpers.spine, helpers.trial, helpers.commands, helpers.log, tried_laws_}, robots_terms_,
              [this](std::uint64_t request_id, const Json& changes) {
                lifecycle_.note(request_id, "param_changes", changes);
              }) {}

std::variant<swap::Terms, Refusal> Swaps::read_terms(const Json& args) const {
  for (const auto& [name, value] : args.items()) {
    if (!swap::is_term(name) && name != "source" && name != "name" && name != "params" && name != "supersede") {
      return Refusal{"usage", fmt::format("swap has no argument '{}'", name), "see docs/reference/verbs.md"};
    }
  }
  return swap::read_terms(args, robots_terms_, help_.spine.info().rate_hz);
}

// A shadow run needs a law that is active.
std::optional<Refusal> Swaps::no_shadow(const swap::Terms& terms) const {
  wire::Telemetry now{};
  (void)help_.spine.latest(now);
  const auto mode = static_cast<wire::Mode>(now.mode);
  if (terms.shadow_s == 0 || (now.law_id != 0 && (mode == wire::Mode::active || mode == wire::Mode::hold))) {
    return std::nullopt;
  }
  return Refusal{"refused_mode",
                 fmt::format("a shadow runs beside the active law, and in mode {} none runs", to_string(mode)),
                 "arm first: lithe arm; or swap without a shadow"};
}

void Swaps::submit(swap::Request request, Callback callback, std::int64_t now_ns) {
  if (const auto refusal = no_shadow(request.terms)) {
    callback(*refusal);
    return;
  }
  const std::uint64_t id = queue_.submit(std::move(request), now_ns);
  if (id == 0) {
    callback(Refusal{"busy", fmt::format("{} swaps wait already", swap::Queue::kMaxWaiting), "try again later"});
    return;
  }
  waiting_[id].callback = std::move(callback);
  keep_record(*queue_.newest());
  queue_.step(now_ns);
}

void Swaps::serve(std::int64_t now_ns) {
  poll_stage(now_ns);
  queue_.step(now_ns);
  lifecycle_.serve(now_ns);
  if (late_.waiting() > 0 && (late_.retry(book_, now_ns), late_.waiting() == 0)) {
    write_failed_.clear();
  }
}

void Swaps::refuse_all(const Refusal& reason, std::int64_t now_ns) {
  take_commit();
  guess_commit(now_ns);
  queue_.refuse_all(reason, now_ns);
  params_.refuse_all(reason);
  lifecycle_.end(reason.message, now_ns);
}

// Only the newest swap is reported: the retirement of an older law does not change it.
void Swaps::remember(const swap::Transaction& swap) {
  const bool begun = swap.stage() != swap::Stage::submitted;
  if (begun && (last_.is_null() || last_["request_id"] <= swap.request_id())) {
    last_ = summary_of(swap.certificate());
  }
}

void Swaps::keep_record(const swap::Transaction& swap) {
  remember(swap);
  Waiting& waiting = waiting_[swap.request_id()];
  if (!waiting.record.path.empty()) {
    rewrite(swap, waiting.record);
  } else if (const auto page = book_.write(swap.certificate())) {
    waiting.record = *page;
    waiting.record_lost.clear();
    write_failed_.clear();
  } else {
    waiting.record_lost = write_failed_ = page.message();
    spdlog::warn("{}", page.message());
  }
}

swap::Json Swaps::records_trouble() const {
  const std::string& told = late_.waiting() > 0 || !write_failed_.empty() ? write_failed_ : book_.begun_anew();
  return told.empty() ? Json() : Json(told);
}

void Swaps::rewrite(const swap::Transaction& swap, const swap::RecordBook::Page& record) {
  remember(swap);
  if (record.path.empty()) {
    late_.hold(swap.request_id(), swap.certificate());
  } else if (const auto written = book_.rewrite(record, swap.certificate()); !written) {
    write_failed_ = written.message();
    spdlog::warn("{}", written.message());
  } else {
    write_failed_.clear();
  }
}

std::uint64_t Swaps::missed_releases() const {
  wire::Telemetry now{};
  (void)help_.spine.latest(now);
  return now.missed_releases;
}

void Swaps::note(const swap::Transaction& swap, const char* kind, const std::string& text) {
  log(swap.request_id(), kind, text);
}

void Swaps::log(std::uint64_t request_id, const char* kind, const std::string& text) {
  help_.log.add({{"t_ns", monotonic_ns()}, {"tick", 0}, {"kind", kind}, {"request_id", request_id}, {"text", text}});
  spdlog::info("{}: {}", kind, text);
}

// Asks the compile service for the source line. `offset` [bytes]: from the start of the slot, or of the object when not
// `placed`.
void Swaps::find_line(const swap::Transaction& swap, std::uint64_t offset, bool placed, LawLifecycle::Found found) {
  const auto located = [file = swap.request().name, found = std::move(found)](const Answer& answer) {
    const Json* place = std::get_if<Json>(&answer);
    if (place == nullptr) {
      found(nullptr);
      return;
    }
    found(
        {{"where", fmt::format("{}:{}", file, place->value("line", 0))}, {"function", place->value("function", "?")}});
  };
  help_.lawd.locate(swap.compiled().hash, offset, placed, located, monotonic_ns());
}

// The source line of a law fault in the Spine. This event comes after the event of the fault.
void Swaps::locate(const swap::Transaction& swap, std::uint32_t offset, LawLifecycle::Found found) {
  const auto tell = [this, id = swap.request_id(), law = swap.compiled().law,
                     found = std::move(found)](const Json& place) {
    if (place.is_object()) {
      log(id, "law_fault_located",
          fmt::format("{} at {}, in {}", law, place.value("where", "?"), place.value("function", "?")));
    }
    found(place);
  };
  find_line(swap, offset, true, tell);
}

void Swaps::finish(swap::Transaction&& swap) {
  const bool was_head = waiting_.contains(swap.request_id()) && swap.reached(swap::Stage::compiled);
  if (was_head) {
    give_slot_back();
    ticket_.reset();
    commit_.reset();
  }
  keep_record(swap);
  const Waiting waiting = std::move(waiting_[swap.request_id()]);
  waiting_.erase(swap.request_id());
  Json certificate = swap.certificate();
  if (!waiting.record_lost.empty()) {
    late_.hold(swap.request_id(), certificate);
    certificate["record_lost"] = waiting.record_lost;
  }
  if (!swap.refusal()) {
    lifecycle_.follow(std::move(swap), waiting.record, before_, monotonic_ns());
    waiting.callback(certificate);
    return;
  }
  note(swap, swap.outcome_is_known() ? "swap_refused" : "swap_not_confirmed",
       fmt::format("{}: {}", swap.request().name, swap.refusal()->message));
  Refusal refusal = *swap.refusal();
  if (refusal.detail.is_null()) {
    refusal.detail = Json::object();
  }
  certificate.erase("error");
  refusal.detail["swap"] = std::move(certificate);
  waiting.callback(refusal);
  if (swap.outcome_is_known()) {
    tried_laws_.forget(swap.request_id());
  } else {
    unconfirmed_.push_back({std::move(swap), waiting.record});
    if (unconfirmed_.size() > kMostUnconfirmed) {
      unconfirmed_.pop_front();
    }
  }
}

// A swap that timed out, and whose outcome the Spine reports later.
void Swaps::come_late(const wire::Event& event) {
  const auto found = std::find_if(unconfirmed_.begin(), unconfirmed_.end(),
                                  [&](const Unconfirmed& each) { return each.swap.request_id() == event.request_id; });
  const auto kind = static_cast<wire::EventKind>(event.kind);
  const bool committed = kind == wire::EventKind::law_committed;
  if (found == unconfirmed_.end() || (!committed && kind != wire::EventKind::law_refused)) {
    return;
  }
  auto [swap, record] = std::move(*found);
  unconfirmed_.erase(found);
  if (!committed) {
    swap.mark_refused(stage_refusal(static_cast<wire::StageResult>(event.code), text_of(event.text)), event.t_ns);
    tried_laws_.forget(swap.request_id());
    note(swap, "swap_refused", fmt::format("{}: after it was given up", swap.request().name));
    rewrite(swap, record);
    return;
  }
  swap.mark_committed(event.tick, event.code, event.t_ns);
  swap.note_missed_after(missed_releases());
  note(swap, "swap_committed_late", fmt::format("{}: it was given up, and runs now", swap.request().name));
  rewrite(swap, record);
  lifecycle_.follow(std::move(swap), record, {}, monotonic_ns());  // without counts: other swaps came in between
}

// Writes into the certificate which State fields start from their defaults.
void Swaps::not_carried(const wire::Event& event) {
  const Json what = not_carried_json(event);
  if (is_head(event.request_id)) {
    queue_.note(event.request_id, "state_not_carried", what);
  } else {
    lifecycle_.note(event.request_id, "state_not_carried", what);
  }
}

}  // namespace lithe::control
