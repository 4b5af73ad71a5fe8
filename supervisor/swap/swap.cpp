// SPDX-License-Identifier: Apache-2.0
// One swap, from the text of a law to the tick that runs it: swap_law() has all steps in order. Below it is what each
// step asks of another process, what the answers mean, and what the Spine says of the law.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"
#include "supervisor/swap/swaps.hpp"

namespace lithe::control {
namespace {

// Time limits of the steps. Those of the compile service and the trial follow the robot file's swap.compile_s.
constexpr std::int64_t kStageNs = 10'000'000'000;
constexpr std::int64_t kCommitNs = 5'000'000'000;   // plus twice the time in the shadow: ticks may be lost
constexpr std::int64_t kWordsGraceNs = 50'000'000;  // for the event of what shared memory shows already

constexpr double kLongShadowS = 5;  // a swap waits for a shadow that ends sooner
constexpr Stage kInTheSpine[] = {Stage::staged, Stage::shadow, Stage::committed};
constexpr const char* kSkipped = "skipped: the gates are open";

// Once the Loader has the law it cannot be cancelled: it may still be committed.
Refusal too_late(const SwapState& swap, const char* doing, std::int64_t limit_ns) {
  const std::string what =
      fmt::format("{} '{}' took longer than {} s", doing, swap.request().name, limit_ns / 1'000'000'000);
  return swap.stage() < Stage::tried
             ? Refusal{"timeout", what, "the running law is unchanged; try again, or look at the log of `lithe run`"}
             : Refusal{"timeout", "the swap is not confirmed: " + what + "; it may still take effect",
                       "see which law runs: lithe status"};
}

// The present step, until there is an answer or its time is up.
template <class T>
Sequence::Reply<T> reply(const typename Sequence::Reply<T>::Pending& pending, const SwapState& swap, const char* doing,
                         std::int64_t limit_ns) {
  return {pending, swap.stage_since_ns() + limit_ns, too_late(swap, doing, limit_ns)};
}

template <class T>
auto pending_for() {
  return std::make_shared<std::optional<typename Sequence::Reply<T>::Outcome>>();
}

Refusal at_line(Refusal refusal, const Json& place) {
  if (place.is_object()) {
    refusal.message = fmt::format("{}: {}", place.value("where", ""), refusal.message);
    refusal.detail["where"] = place["where"];
  }
  return refusal;
}

// Bounded copy into a zero-terminated field; false when the text does not fit.
template <std::size_t N>
bool put(std::array<char, N>& field, const std::string& text) {
  if (text.size() >= N) return false;
  std::memcpy(field.data(), text.c_str(), text.size() + 1);
  return true;
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

// Each co_await starts a step in another process and goes on with its answer, or with the reason why there is none.
// Whatever the end, the state of the swap has it: settle() answers the client and writes the certificate.
Sequence Swaps::swap_law(SwapState& swap) {
  // queued -> compiled -> admitted: lawd runs the compiler and every gate.
  swap.mark_started(now_ns());
  note(swap, "swap_submitted", swap.request().name);
  auto compiled = co_await compile(swap);
  if (const auto* no = std::get_if<Refusal>(&compiled)) co_return refuse(swap, *no);
  admitted(swap, std::get<Compiled>(std::move(compiled)));

  // -> placed: lawd links the object for a free slot of the arena and writes it there.
  const auto where = co_await place(swap);
  if (const auto* no = std::get_if<Refusal>(&where)) co_return refuse(swap, *no);
  placed(swap, std::get<Placed>(where));

  // -> tried: lithe-trial runs the placed law in its sandbox. A law that crashed there is told its line.
  const auto how = co_await attempt(swap);
  if (const auto* no = std::get_if<Refusal>(&how)) {
    const auto line = co_await line_of_crash(swap, *no);
    co_return refuse(swap,
                     std::holds_alternative<Json>(line) ? at_line(*no, std::get<Json>(line)) : std::get<Refusal>(line));
  }
  swap.mark(Stage::tried, std::get<std::string>(how), now_ns());
  if (swap.request().dry_run) co_return refuse(swap, {"dry_run", "it passed every gate, and was only tried", ""});

  // -> staged: the Loader checks and warms it, and offers it to the tick. From here on the Spine has the law: what is
  // given up may still be committed.
  if (const auto no = stage(swap)) co_return refuse(swap, *no);
  for (const Stage next : kInTheSpine) {
    if (next == Stage::shadow && swap.request().terms.shadow_s == 0)
      continue;  // on request only: first it runs beside the active law, without effect
    const auto why_not = co_await spine_reaches(next, swap);
    if (heard_.refusal) co_return refuse(swap, *heard_.refusal);
    if (why_not && !find_commit(now_ns())) co_return give_up(swap, *why_not);
    mark_heard(swap);
    if (heard_.measured) {  // it was not to be promoted: the running law goes on
      swap.mark(Stage::measured, text_of(heard_.measured->text), heard_.measured->t_ns);
      co_return;
    }
  }

  // -> committed: one tick has taken it. Its probation confirms it or takes it back (law_lifecycle.hpp).
  swap.mark_committed(heard_.commit->tick, heard_.commit->code, heard_.commit->t_ns);
}

void Swaps::refuse(SwapState& swap, const Refusal& reason) { swap.mark_refused(reason, now_ns()); }

void Swaps::give_up(SwapState& swap, const Refusal& reason) { swap.mark_given_up(reason, now_ns()); }

Sequence::Reply<Compiled> Swaps::compile(const SwapState& swap) {
  const auto pending = pending_for<Compiled>();
  const auto take = [this, pending, params = swap.request().params](const Answer& answer) {
    if (const auto* refusal = std::get_if<Refusal>(&answer)) {
      *pending = *refusal;
    } else {
      Compiled compiled = compiled_of(std::get<Json>(answer));
      const auto wrong = wrong_param(params, compiled.descriptor);
      *pending = wrong ? Sequence::Reply<Compiled>::Outcome(*wrong) : std::move(compiled);
    }
    go_on(monotonic_ns());
  };
  help_.lawd.compile({swap.request().name, swap.request().source, swap.request().terms.budget_ns()}, take,
                     monotonic_ns());
  return reply<Compiled>(pending, swap, "compiling", 2 * help_.lawd.limit_ns());
}

void Swaps::admitted(SwapState& swap, Compiled compiled) {
  note(swap, "swap_compiled",
       fmt::format("{} in {:.0f} ms{}", compiled.law, compiled.compile_ms, compiled.cached ? " (cached)" : ""));
  const std::string words =
      gates_are_open() ? kSkipped : fmt::format("{} gates", compiled.facts.value("gates", Json()).size());
  note(swap, "swap_admitted", words);
  const std::int64_t compiled_ns = now_ns() - compiled.admission_ns;
  swap.mark_compiled(std::move(compiled), compiled_ns);
  swap.mark(Stage::admitted, words, now_ns());
}

Sequence::Reply<Placed> Swaps::place(const SwapState& swap) {
  const auto pending = pending_for<Placed>();
  const bool with_dlopen = !lawd_can_place_ || !help_.spine.has_arena();
  const std::uint32_t slot = with_dlopen ? 0 : help_.spine.take_slot();
  const auto take = [this, pending, slot, id = swap.request_id()](const std::variant<Placed, Refusal>& answer) {
    const auto* refusal = std::get_if<Refusal>(&answer);
    const bool gone = !is_head(id);  // it was given up in between
    if (refusal != nullptr || gone) help_.spine.give_back(slot);
    if (refusal != nullptr && refusal->code == "arena_failed") {
      spdlog::warn("{}; laws are loaded with dlopen", refusal->message);
      lawd_can_place_ = false;
      *pending = Placed{};
    } else {
      *pending = answer;
    }
    if (!gone) go_on(monotonic_ns());
  };
  if (with_dlopen) {
    *pending = Placed{};
  } else if (slot == 0) {
    *pending = Refusal{"slots_full", fmt::format("all {} slots of the code arena are in use", arena::kSlots),
                       "another swap is under way in the Spine; try again"};
  } else {
    help_.lawd.place(swap.compiled().hash, slot, take, monotonic_ns());
  }
  return reply<Placed>(pending, swap, "placing", 2 * help_.lawd.limit_ns());
}

void Swaps::placed(SwapState& swap, const Placed& where) {
  placed_ = where;
  std::string words = "not in the arena: loaded with dlopen";
  if (where.slot != 0) {
    words = fmt::format("slot {}, {} bytes in {:.1f} ms", where.slot, where.code_bytes, where.place_ms);
    swap.note("placement", {{"slot", where.slot},
                            {"code_bytes", where.code_bytes},
                            {"image_hash", fmt::format("{:016x}", where.image_hash)},
                            {"place_ms", where.place_ms}});
  }
  note(swap, "swap_placed", words);
  swap.mark(Stage::placed, words, now_ns());
}

Sequence::Reply<std::string> Swaps::attempt(const SwapState& swap) {
  const auto pending = pending_for<std::string>();
  if (gates_are_open()) {
    *pending = kSkipped;
  } else {
    const auto take = [this, pending, id = swap.request_id()](const Answer& answer) {
      if (is_head(id)) {
        *pending = tried(head_->swap, answer);
        go_on(monotonic_ns());
      }
    };
    help_.trial->attempt(request_of(swap), take, monotonic_ns());
  }
  return reply<std::string>(pending, swap, "trying", help_.lawd.limit_ns());
}

TrialRequest Swaps::request_of(const SwapState& swap) const {
  TrialRequest request;
  request.object = swap.compiled().object;
  request.placed = *placed_;
  request.budget_ns = swap.request().terms.budget_ns();
  request.box_ms = static_cast<int>(swap.request().terms.box_ms);
  request.recording = text_of(help_.spine.info().robot);
  request.params = swap.request().params;
  return request;
}

// The trial's words on success. Its report is in the certificate in any case.
std::variant<std::string, Refusal> Swaps::tried(SwapState& swap, const Answer& answer) {
  const auto* refusal = std::get_if<Refusal>(&answer);
  Json report = refusal == nullptr            ? std::get<Json>(answer)
                : refusal->detail.is_object() ? refusal->detail.value("trial", Json())
                                              : Json();
  const Json values = all_params(swap.request().params, swap.compiled().descriptor);
  if (report.is_object()) {
    const auto running = refusal == nullptr ? help_.spine.running_law() : std::nullopt;
    for (const std::string& worse : running ? tried_laws_.worse_than(*running, report) : std::vector<std::string>{})
      report["warnings"].push_back(worse);
    if (const std::string missing = missing_sensor(values, help_.spine.info()); !missing.empty())
      report["warnings"].push_back(missing);
    swap.note("trial", report);
  }
  if (refusal != nullptr) return *refusal;
  const Json timing = report.value("report", Json::object()).value("timing", Json::object());
  std::string words = fmt::format("passed in {:.0f} ms, a step takes {:.0f} ns (p99.9, best of 3), at most {:.0f} ns",
                                  report.value("ms", 0.0), timing.value("p999_ns", 0.0), timing.value("worst_ns", 0.0));
  note(swap, "swap_tried", words);
  tried_laws_.passed(swap.request_id(), request_of(swap), values, report);
  return words;
}

// The source line of a crash in the trial, as for a crash in the Spine; null when there was none.
Sequence::Reply<Json> Swaps::line_of_crash(const SwapState& swap, const Refusal& refusal) {
  const auto pending = pending_for<Json>();
  const std::uint64_t offset = offset_in(refusal);
  if (offset == 0) {
    *pending = Json();
  } else {
    find_line(swap, offset, placed_->slot != 0, [this, pending](const Json& place) {
      *pending = place;
      go_on(monotonic_ns());
    });
  }
  return reply<Json>(pending, swap, "trying", help_.lawd.limit_ns());
}

// Sends the law to the Loader.
std::optional<Refusal> Swaps::stage(SwapState& swap) {
  swap.note_missed_before(missed_releases());
  wire::StageRequest request;
  request.request_id = swap.request_id();
  request.source_hash = leading_number<std::uint64_t>(swap.compiled().hash.substr(0, 16), 16);
  request.slot = placed_->slot;
  request.code_bytes = placed_->code_bytes;
  request.entry = placed_->entry;
  request.image_hash = placed_->image_hash;
  control::put_terms(swap.request().terms, help_.spine.info().rate_hz, request);
  put_params(swap.request().params, swap.compiled().descriptor, request);
  const std::string& object = swap.compiled().object;
  if (!put(request.path, object) || !put(request.name, swap.compiled().law)) {
    return Refusal{"path_too_long", fmt::format("{} does not fit the Spine's field", object),
                   "set LITHE_CACHE_DIR to a shorter path"};
  }
  lifecycle_.measure_all();  // the counts of earlier laws must not include this one
  before_ = count_core(help_.spine.spine_pid(), help_.spine.info());
  const auto ticket = help_.spine.stage(request);
  if (!ticket) return stage_refusal(wire::StageResult::busy, "the Loader does not take requests");
  placed_.reset();
  heard_.ticket = *ticket;
  return std::nullopt;
}

Sequence::Until Swaps::spine_reaches(Stage stage, const SwapState& swap) {
  const auto ready = [this, stage](std::int64_t now_ns) {
    look(now_ns);
    return heard_.refusal.has_value() || heard_.stage() >= stage;
  };
  const bool loading = stage == Stage::staged;
  const std::int64_t limit_ns =
      loading ? kStageNs : kCommitNs + static_cast<std::int64_t>(2e9 * swap.request().terms.shadow_s);
  return {ready, swap.stage_since_ns() + limit_ns, too_late(swap, loading ? "loading" : "committing", limit_ns)};
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
                "the laws are as before; where they disagree make them agree, or swap without a shadow"};
  }
}

// Only one law at a time runs beside the active one. Who would wait for long is told whose shadow it is.
std::optional<Refusal> Swaps::long_shadow(std::int64_t now_ns) const {
  if (heard_.shadow_ns == 0) return std::nullopt;
  const SwapState& swap = head_->swap;
  const double left_s =
      std::ceil(swap.request().terms.shadow_s - 1e-9 * static_cast<double>(now_ns - heard_.shadow_ns));
  if (left_s <= kLongShadowS) return std::nullopt;
  return Refusal{
      "busy",
      fmt::format("swap {} ('{}') runs in the shadow of the active law for {:.0f} s more; meanwhile no law can "
                  "be swapped",
                  swap.request_id(), swap.request().name, left_s),
      fmt::format("send it again in {:.0f} s; disarm or a rollback ends the shadow", left_s)};
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

}  // namespace lithe::control
