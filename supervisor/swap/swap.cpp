// SPDX-License-Identifier: Apache-2.0
// One swap, from the text of a law to the tick that runs it: swap_law() has all steps in order. Below it is what each
// step asks of another process, and what the answers mean.
#include <fmt/format.h>

#include <array>
#include <cstring>
#include <utility>

#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"
#include "supervisor/swap/swaps.hpp"

namespace lithe::control {
namespace {

// Time limits of the steps. Those of the compile service and the trial follow the robot file's swap.compile_s.
constexpr std::int64_t kStageNs = 10'000'000'000;
constexpr std::int64_t kCommitNs = 5'000'000'000;  // plus twice the time in the shadow: ticks may be lost

constexpr Stage kInTheSpine[] = {Stage::staged, Stage::shadow, Stage::committed};
// The report in a refusal of the trial; an empty object when there is none.
Json report_in(const Refusal& refusal) {
  return refusal.detail.is_object() ? refusal.detail.value("trial", Json::object()) : Json::object();
}

// Where in the code it failed [bytes]; 0 = not known.
std::uint64_t offset_in(const Json& report) {
  const auto found = report.find("pc_offset");
  return found != report.end() && found->is_number_unsigned() ? found->get<std::uint64_t>() : 0;
}

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

// Time of the admission gates [ns]; 0 for a law from the cache, which was admitted earlier.
std::int64_t admission_ns(const Json& compiled) {
  double ms = 0.0;
  if (!compiled.value("cached", false))
    for (const Json& gate : compiled.value("gates", Json::array())) ms += gate.value("ms", 0.0);
  return static_cast<std::int64_t>(ms * 1e6);
}

// The answer of the compile service; what goes into the certificate is in `facts`.
std::variant<Compiled, Refusal> read_compiled(const Answer& answer, const Json& params) {
  if (const auto* refusal = std::get_if<Refusal>(&answer)) return *refusal;
  const Json& result = std::get<Json>(answer);
  const Json law = result.value("law", Json::object());
  if (auto wrong = wrong_param(params, law)) return std::move(*wrong);
  Json facts = Json::object();
  for (const char* key : {"object_sha256", "placeable_sha256", "toolchain", "gates", "steps_ms", "dry_step_max_ns",
                          "warnings", "cleaned"}) {
    if (result.contains(key)) facts[key] = result[key];
  }
  return Compiled{result.value("object", ""),
                  result.value("hash", ""),
                  law.value("name", ""),
                  result.value("cached", false),
                  result.value("compile_ms", 0.0),
                  admission_ns(result),
                  law,
                  std::move(facts)};
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
    *pending = read_compiled(answer, params);
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
  const auto take = [this, pending, id = swap.request_id()](const std::variant<Placed, Refusal>& answer) {
    if (const auto* where = std::get_if<Placed>(&answer); where != nullptr && !is_head(id)) {
      placement_.forget(where->slot);  // the swap was given up in between
      return;
    }
    *pending = answer;
    go_on(monotonic_ns());
  };
  placement_.place(swap.compiled().hash, take, monotonic_ns());
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
  if (report.is_object()) {
    const auto running = refusal == nullptr ? help_.spine.running_law() : std::nullopt;
    for (const std::string& worse : running ? tried_laws_.worse_than(*running, report) : std::vector<std::string>{})
      report["warnings"].push_back(worse);
    swap.note("trial", report);
  }
  if (refusal != nullptr) return *refusal;
  const Json timing = report.value("report", Json::object()).value("timing", Json::object());
  std::string words = fmt::format("passed in {:.0f} ms, a step takes {:.0f} ns (p99.9, best of 3), at most {:.0f} ns",
                                  report.value("ms", 0.0), timing.value("p999_ns", 0.0), timing.value("worst_ns", 0.0));
  note(swap, "swap_tried", words);
  tried_laws_.passed(swap.request_id(), request_of(swap), all_params(swap.request().params, swap.compiled().descriptor),
                     report);
  return words;
}

// The source line of a crash in the trial, as for a crash in the Spine; null when there was none.
Sequence::Reply<Json> Swaps::line_of_crash(const SwapState& swap, const Refusal& refusal) {
  const auto pending = pending_for<Json>();
  const std::uint64_t offset = offset_in(report_in(refusal));
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

// A NaN in the Spine has no address: the tick only sees the output. The trial repeats the law, from a fresh State, on
// what the robot has just recorded, and stops at the operation that makes a NaN there; null when that makes none.
void Swaps::find_line_of_nan(const SwapState& swap, LawLifecycle::Found found) {
  const auto again = help_.trial != nullptr ? tried_laws_.again(swap.request_id()) : std::nullopt;
  if (!again) return found(nullptr);
  const auto take = [this, swap, found = std::move(found)](const Answer& answer) {
    const auto* refusal = std::get_if<Refusal>(&answer);
    const Json report = refusal != nullptr ? report_in(*refusal) : Json::object();
    if (report.value("section", "") != "replay" || offset_in(report) == 0) return found(nullptr);
    find_line(swap, offset_in(report), false, found);
  };
  help_.trial->attempt(*again, take, monotonic_ns(), TrialLink::Turn::idle);  // a swap may replace the law meanwhile
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
  if (placed_->slot != 0) placement_.asked(placed_->slot, *ticket);
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

}  // namespace lithe::control
