// SPDX-License-Identifier: Apache-2.0
// The queue of swaps, their answers and certificates; what the Spine says goes to the swap that it is about. The steps
// of one swap are in swap.cpp.
#include "supervisor/swap/swaps.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <set>
#include <string_view>
#include <utility>

#include "spine/core/time.hpp"

namespace lithe::control {
namespace {

std::filesystem::path text_beside(std::filesystem::path certificate) {
  return certificate.empty() ? certificate : certificate.replace_extension("cpp");
}

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

}  // namespace

Refusal stage_refusal(wire::StageResult result, const std::string& words) {
  const std::string code(to_string(result));
  const char* next = result == wire::StageResult::busy ? "the running law is unchanged; try again"
                     : result == wire::StageResult::slots_full
                         ? "another swap is under way in the Spine; try again"
                         : "the running law is unchanged; lithe law check tells more";
  return {code, words.empty() ? fmt::format("the Loader refused the law: {}", code) : words, next};
}

Swaps::Swaps(const Helpers& helpers, CertificateFiles book, std::uint64_t first_request_id,
             const robot::RobotConfig& robot)
    : help_(helpers),
      book_(std::move(book)),
      robots_terms_(terms_of(robot, helpers.spine.info().rate_hz)),
      lifecycle_(
          helpers.spine, [this](const SwapState& each, const CertificateFiles::Page& record) { rewrite(each, record); },
          [this](const SwapState& each, std::uint32_t offset, LawLifecycle::Found found) {
            locate(each, offset, std::move(found));
          },
          [this](const SwapState& each, const std::string& sentence) {
            note(each, "law_rollback_explained", fmt::format("{}: {}", each.compiled().law, sentence));
          }),
      tried_laws_(helpers.spine),
      params_({helpers.spine, helpers.trial, helpers.commands, helpers.log, tried_laws_}, robots_terms_,
              [this](std::uint64_t request_id, const Json& changes) {
                lifecycle_.note(request_id, "param_changes", changes);
              }),
      next_id_(first_request_id) {}

std::variant<SwapTerms, Refusal> Swaps::read_terms(const Json& args) const {
  constexpr std::array<std::string_view, 6> kOtherArguments{"source",    "name",   "params",
                                                            "supersede", "fenced", "dry_run"};
  for (const auto& [name, value] : args.items())
    if (!is_term(name) && std::ranges::find(kOtherArguments, name) == kOtherArguments.end())
      return Refusal{"usage", fmt::format("swap has no argument '{}'", name), "see docs/reference/verbs.md"};
  return control::read_terms(args, robots_terms_, help_.spine.info().rate_hz);
}

// A shadow run needs a law that is active.
std::optional<Refusal> Swaps::no_shadow(const SwapTerms& terms) const {
  const wire::Telemetry now = help_.spine.now();
  const auto mode = static_cast<wire::Mode>(now.mode);
  if (terms.shadow_s == 0 || (now.law_id != 0 && (mode == wire::Mode::active || mode == wire::Mode::hold)))
    return std::nullopt;
  return Refusal{"refused_mode",
                 fmt::format("a shadow runs beside the active law, and in mode {} none runs", to_string(mode)),
                 "arm first: lithe arm; or swap without a shadow"};
}

void Swaps::submit(SwapRequest request, Callback callback, std::int64_t now_ns) {
  if (const auto refusal = no_shadow(request.terms)) return callback(*refusal);
  if (request.supersede) supersede(request, now_ns);
  if (waiting_.size() + (head_ ? 1 : 0) >= kMaxWaiting)
    return callback(Refusal{"busy", fmt::format("{} swaps wait already", kMaxWaiting), "try again later"});
  waiting_.push_back({SwapState(next_id_++, std::move(request), now_ns), std::move(callback)});
  keep_record(waiting_.back());
  go_on(now_ns);
  begin_next(now_ns);
}

// Only a waiting request is replaced, at most one; the head has already started.
void Swaps::supersede(const SwapRequest& newer, std::int64_t now_ns) {
  const auto is_it = [&](const Entry& each) {
    const SwapRequest& older = each.swap.request();
    return newer.client != 0 && older.client == newer.client && older.name == newer.name;
  };
  const auto found = std::ranges::find_if(waiting_, is_it);
  if (found == waiting_.end()) return;
  refuse_waiting(found, {"superseded", fmt::format("a newer request for '{}' takes its place", newer.name), ""},
                 now_ns);
}

void Swaps::refuse_waiting(std::deque<Entry>::iterator which, const Refusal& reason, std::int64_t now_ns) {
  Entry gone = std::move(*which);
  waiting_.erase(which);
  gone.swap.mark_refused(reason, now_ns);
  finish(std::move(gone));
}

void Swaps::begin_next(std::int64_t now_ns) {
  if (!head_ && !waiting_.empty()) {
    head_ = std::move(waiting_.front());
    waiting_.pop_front();
    sequence_.emplace(swap_law(head_->swap));
    go_on(now_ns);
  }
}

// Called whenever something has come that the swap under way may wait for.
void Swaps::go_on(std::int64_t now_ns) {
  if (sequence_) {
    sequence_->serve(now_ns);
    if (sequence_->done()) settle();
  }
}

void Swaps::settle() {
  if (placed_ && placed_->slot != 0) help_.spine.give_back(placed_->slot);
  placed_.reset();
  heard_ = {};
  sequence_.reset();
  Entry entry = std::move(*head_);
  head_.reset();
  entry.swap.note_missed_after(missed_releases());
  finish(std::move(entry));
}

void Swaps::serve(std::int64_t now_ns) {
  go_on(now_ns);
  begin_next(now_ns);
  if (const auto reason = long_shadow(now_ns))
    while (!waiting_.empty()) refuse_waiting(waiting_.begin(), *reason, now_ns);
  lifecycle_.serve(now_ns);
  if (late_.waiting() > 0 && (late_.retry(book_, now_ns), late_.waiting() == 0)) write_failed_.clear();
}

void Swaps::refuse_all(const Refusal& reason, std::int64_t now_ns) {
  while (sequence_ || !waiting_.empty()) {  // an answer may bring a new request
    if (sequence_) {
      sequence_->abort(reason, now_ns);
      go_on(now_ns);
    } else {
      refuse_waiting(waiting_.begin(), reason, now_ns);
    }
  }
  params_.refuse_all(reason);
  lifecycle_.end(reason.message, now_ns);
}

// Only the newest swap is reported: the retirement of an older law does not change it.
void Swaps::remember(const SwapState& swap) {
  const bool begun = swap.stage() != Stage::submitted;
  if (begun && (last_.is_null() || last_["request_id"] <= swap.request_id())) last_ = summary_of(swap.certificate());
}

void Swaps::keep_record(Entry& entry) {
  remember(entry.swap);
  if (!entry.record.path.empty()) {
    entry.record_lost = rewrite(entry.swap, entry.record) ? "" : write_failed_;
  } else if (const auto page = book_.write(entry.swap.certificate(), entry.swap.request().source)) {
    entry.record = *page;
    entry.record_lost.clear();
    if (late_.waiting() == 0) write_failed_.clear();
    drop_old_sources();
  } else {
    entry.record_lost = write_failed_ = page.message();
    spdlog::warn("{}", page.message());
  }
}

void Swaps::write_last_certificates(std::int64_t now_ns) {
  late_.retry(book_, now_ns + LateCertificates::kPauseNs);
  if (const std::size_t lost = late_.waiting(); lost > 0)
    spdlog::error(
        "{} certificate{} lost: nothing could be written to {} until the end; free space there, or set LITHE_OUT_DIR, "
        "before the next lithe run",
        lost, lost == 1 ? " is" : "s are", records().string());
}

// A rollback leads to the laws that are loaded; `activate` names the text of any other that ran.
void Swaps::drop_old_sources() {
  std::set<std::filesystem::path> needed;
  for (const auto& page : lifecycle_.pages()) needed.insert(text_beside(page));
  for (const auto& [law, text] : sources_.all()) needed.insert(text);
  book_.drop_old_texts(needed);
}

std::filesystem::path Swaps::source_of(const std::string& law) const {
  const std::filesystem::path text = sources_.find(law);
  std::error_code failure;
  return std::filesystem::exists(text, failure) ? text : std::filesystem::path();
}

std::filesystem::path Swaps::source_of(std::uint32_t law_id) const {
  const std::filesystem::path text = text_beside(lifecycle_.page_of(law_id));
  std::error_code failure;
  return std::filesystem::exists(text, failure) ? text : std::filesystem::path();
}

Json Swaps::certificates_error() const {
  const std::string& told = late_.waiting() > 0 || !write_failed_.empty() ? write_failed_ : book_.begun_anew();
  return told.empty() ? Json() : Json(told);
}

bool Swaps::rewrite(const SwapState& swap, const CertificateFiles::Page& record) {
  remember(swap);
  if (record.path.empty()) {
    late_.hold(swap.request_id(), swap.certificate());
    return false;
  }
  if (const auto written = book_.rewrite(record, swap.certificate()); !written) {
    late_.hold(swap.request_id(), swap.certificate(), record);
    write_failed_ = written.message();
    spdlog::warn("{}", written.message());
    return false;
  }
  late_.forget(swap.request_id());
  if (late_.waiting() == 0) write_failed_.clear();
  return true;
}

std::uint64_t Swaps::missed_releases() const { return help_.spine.now().missed_releases; }

void Swaps::note(const SwapState& swap, const char* kind, const std::string& text) {
  help_.log.note(swap.request_id(), kind, text);
}

std::uint64_t offset_in(const Refusal& refusal, std::string_view section) {
  const Json report = refusal.detail.is_object() ? refusal.detail.value("trial", Json::object()) : Json::object();
  const bool wanted = section.empty() || report.value("section", "") == section;
  const auto found = report.find("pc_offset");
  return wanted && found != report.end() && found->is_number_unsigned() ? found->get<std::uint64_t>() : 0;
}

// Asks the compile service for the source line. `offset` [bytes]: from the start of the slot, or of the object when not
// `placed`.
void Swaps::find_line(const SwapState& swap, std::uint64_t offset, bool placed, LawLifecycle::Found found) {
  const auto located = [file = swap.request().name, found = std::move(found)](const Answer& answer) {
    const Json* place = std::get_if<Json>(&answer);
    if (place == nullptr) return found(nullptr);
    found(
        {{"where", fmt::format("{}:{}", file, place->value("line", 0))}, {"function", place->value("function", "?")}});
  };
  help_.lawd.locate(swap.compiled().hash, offset, placed, located, monotonic_ns());
}

// A NaN in the Spine has no address: the tick only sees the output. The trial repeats the law, from a fresh State, on
// what the robot has just recorded, and stops at the operation that makes a NaN there; null, and an event that says
// why, when that makes none.
void Swaps::find_line_of_nan(const SwapState& swap, LawLifecycle::Found found) {
  const auto none = [this, swap, found](const std::string& why) {
    note(swap, "law_fault_not_located",
         fmt::format("{}: the line of what is not finite is not known: {}", swap.compiled().law, why));
    found(nullptr);
  };
  const auto again = help_.trial != nullptr ? tried_laws_.again(swap.request_id()) : std::nullopt;
  if (!again) return none("its trial cannot be repeated");
  const auto take = [this, swap, none, found](const Answer& answer) {
    const auto* refusal = std::get_if<Refusal>(&answer);
    const std::uint64_t offset = refusal != nullptr ? offset_in(*refusal, "replay") : 0;
    if (offset == 0)
      return none(refusal != nullptr ? refusal->message : "the trial, on what was recorded, met nothing");
    find_line(swap, offset, false, [none, found](const Json& place) {
      place.is_object() ? found(place) : none("the compile service does not know it");
    });
  };
  help_.trial->attempt(*again, take, monotonic_ns(), TrialLink::Turn::idle);  // a swap may replace the law meanwhile
}

// The source line of a law fault in the Spine. This event comes after the event of the fault.
void Swaps::locate(const SwapState& swap, std::uint32_t offset, LawLifecycle::Found found) {
  const auto tell = [this, id = swap.request_id(), law = swap.compiled().law,
                     found = std::move(found)](const Json& place) {
    if (place.is_object()) {
      help_.log.note(id, "law_fault_located",
                     fmt::format("{} at {}, in {}", law, place.value("where", "?"), place.value("function", "?")));
    }
    found(place);
  };
  if (offset == 0) return find_line_of_nan(swap, tell);
  find_line(swap, offset, true, tell);
}

// The last certificate before the answer, the answer, and who follows the law from here.
void Swaps::finish(Entry entry) {
  SwapState& swap = entry.swap;
  keep_record(entry);
  Json certificate = swap.certificate();
  if (!entry.record.path.empty()) certificate["certificate"] = entry.record.path.filename().string();
  if (!entry.record_lost.empty()) {
    if (entry.record.path.empty()) late_.hold(swap.request_id(), certificate);
    certificate["record_lost"] = entry.record_lost;
  }
  if (swap.stage() == Stage::measured) {
    note(swap, "swap_measured", fmt::format("{}: compared with the running law, not promoted", swap.request().name));
    tried_laws_.forget(swap.request_id());
    return entry.callback(certificate);
  }
  if (!swap.refusal()) {
    if (!entry.record.path.empty()) sources_.add(swap.compiled().law, text_beside(entry.record.path));
    lifecycle_.follow(std::move(swap), entry.record, before_, monotonic_ns());
    return entry.callback(certificate);
  }
  note(swap, swap.outcome_is_known() ? "swap_refused" : "swap_not_confirmed",
       fmt::format("{}: {}", swap.request().name, swap.refusal()->message));
  Refusal refusal = *swap.refusal();
  if (refusal.detail.is_null()) refusal.detail = Json::object();
  certificate.erase("error");
  refusal.detail["swap"] = std::move(certificate);
  entry.callback(refusal);
  if (swap.outcome_is_known()) {
    tried_laws_.forget(swap.request_id());
  } else {
    unconfirmed_.push_back(std::move(entry));
    if (unconfirmed_.size() > kMostUnconfirmed) unconfirmed_.pop_front();
  }
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
    rewrite(swap, late.record);
    return;
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
