// SPDX-License-Identifier: Apache-2.0
// The steps of one swap: compile, place, trial, stage, commit.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cstdlib>
#include <cstring>
#include <utility>

#include "spine/core/time.hpp"
#include "supervisor/swap/swap_words.hpp"
#include "supervisor/swap/swaps.hpp"

namespace lithe::control {
namespace {

using swap::Answer;
using swap::Json;
using swap::Refusal;

constexpr std::int64_t kWordsGraceNs = 50'000'000;

// Bounded copy into a zero-terminated field; false when the text does not fit.
template <std::size_t N>
bool put(std::array<char, N>& field, const std::string& text) {
  if (text.size() >= N) {
    return false;
  }
  std::memcpy(field.data(), text.c_str(), text.size() + 1);
  return true;
}

}  // namespace

bool Swaps::is_head(std::uint64_t request_id) const {
  return queue_.head() != nullptr && queue_.head()->request_id() == request_id;
}

void Swaps::give_slot_back() {
  if (placed_ && placed_->slot != 0) {
    placement_.forget(placed_->slot);
  }
  placed_.reset();
}

void Swaps::compile(const swap::Transaction& swap) {
  note(swap, "swap_submitted", swap.request().name);
  const std::uint64_t id = swap.request_id();
  help_.lawd.compile(
      {swap.request().name, swap.request().source, swap.request().terms.budget_ns()},
      [this, id](const Answer& answer) { compiled(id, answer); }, monotonic_ns());
}

void Swaps::compiled(std::uint64_t request_id, const Answer& answer) {
  const std::int64_t now_ns = monotonic_ns();
  if (!is_head(request_id)) {
    return;
  }
  if (const auto* refusal = std::get_if<Refusal>(&answer)) {
    queue_.on_refused(request_id, *refusal, now_ns);
    return;
  }
  const Json& result = std::get<Json>(answer);
  const Json law = result.value("law", Json::object());
  if (const auto wrong = wrong_param(queue_.head()->request().params, law)) {
    queue_.on_refused(request_id, *wrong, now_ns);
    return;
  }
  swap::Compiled compiled{result.value("object", ""),
                          result.value("hash", ""),
                          law.value("name", ""),
                          result.value("cached", false),
                          result.value("compile_ms", 0.0),
                          admission_ns(result),
                          law,
                          facts_of(result)};
  note(*queue_.head(), "swap_compiled",
       fmt::format("{} in {:.0f} ms{}", compiled.law, compiled.compile_ms, compiled.cached ? " (cached)" : ""));
  const std::string admitted =
      gates_are_open() ? "skipped: the gates are open" : fmt::format("{} gates", result.value("gates", Json()).size());
  note(*queue_.head(), "swap_admitted", admitted);
  queue_.on_compiled(request_id, std::move(compiled), admitted, now_ns);
}

void Swaps::place(const swap::Transaction& swap) {
  const std::uint64_t id = swap.request_id();
  placement_.place(
      swap.compiled().hash, [this, id](const std::variant<Placed, Refusal>& where) { placed(id, where); },
      monotonic_ns());
}

void Swaps::placed(std::uint64_t request_id, const std::variant<Placed, Refusal>& answer) {
  const Placed* where = std::get_if<Placed>(&answer);
  if (where == nullptr) {
    queue_.on_refused(request_id, std::get<Refusal>(answer), monotonic_ns());
    return;
  }
  if (!is_head(request_id)) {
    placement_.forget(where->slot);  // the swap was given up in between
    return;
  }
  placed_ = *where;
  std::string words = "not in the arena: loaded with dlopen";
  if (where->slot != 0) {
    words = fmt::format("slot {}, {} bytes in {:.1f} ms", where->slot, where->code_bytes, where->place_ms);
    queue_.note(request_id, "placement",
                {{"slot", where->slot},
                 {"code_bytes", where->code_bytes},
                 {"image_hash", fmt::format("{:016x}", where->image_hash)},
                 {"place_ms", where->place_ms}});
  }
  note(*queue_.head(), "swap_placed", words);
  queue_.on_placed(request_id, words, monotonic_ns());
}

void Swaps::attempt(const swap::Transaction& swap) {
  const std::uint64_t id = swap.request_id();
  if (gates_are_open()) {
    queue_.on_tried(id, "skipped: the gates are open", monotonic_ns());
    return;
  }
  help_.trial->attempt(order_of(swap), [this, id](const Answer& answer) { tried(id, answer); }, monotonic_ns());
}

TrialOrder Swaps::order_of(const swap::Transaction& swap) const {
  TrialOrder order;
  order.object = swap.compiled().object;
  order.slot = placed_->slot;
  order.code_bytes = placed_->code_bytes;
  order.entry = placed_->entry;
  order.image_hash = placed_->image_hash;
  order.budget_ns = swap.request().terms.budget_ns();
  order.box_ms = static_cast<int>(swap.request().terms.box_ms);
  order.recording = text_of(help_.spine.info().robot);
  order.params = swap.request().params;
  return order;
}

void Swaps::tried(std::uint64_t request_id, const Answer& answer) {
  if (!is_head(request_id)) {
    return;
  }
  const auto* refusal = std::get_if<Refusal>(&answer);
  Json report = refusal != nullptr ? refusal->detail.is_object() ? refusal->detail.value("trial", Json()) : Json()
                                   : std::get<Json>(answer);
  if (report.is_object()) {
    report.erase("id");
    if (refusal == nullptr) {
      compare(report);
    }
    queue_.note(request_id, "trial", report);
  }
  if (refusal != nullptr) {
    refuse_with_line(*queue_.head(), *refusal);
    return;
  }
  const Json timing = report.value("report", Json::object()).value("timing", Json::object());
  const std::string words =
      fmt::format("passed in {:.0f} ms, a step takes {:.0f} ns (p99.9, best of 3), at most {:.0f} ns",
                  report.value("ms", 0.0), timing.value("p999_ns", 0.0), timing.value("worst_ns", 0.0));
  note(*queue_.head(), "swap_tried", words);
  const swap::Transaction& head = *queue_.head();
  tried_laws_.passed(request_id, order_of(head), all_params(head.request().params, head.compiled().descriptor), report);
  queue_.on_tried(request_id, words, monotonic_ns());
}

// Compares with the running law, whose trial used the same inputs.
void Swaps::compare(Json& report) const {
  const auto running = help_.spine.running_law();
  for (const std::string& worse : running ? tried_laws_.worse_than(*running, report) : std::vector<std::string>{}) {
    report["warnings"].push_back(worse);
  }
}

// A law that crashed in the trial gets the source line of the crash, as for a crash in the Spine.
void Swaps::refuse_with_line(const swap::Transaction& swap, const Refusal& refusal) {
  const Json trial = refusal.detail.is_object() ? refusal.detail.value("trial", Json::object()) : Json::object();
  const auto offset = trial.value("pc_offset", std::uint64_t{0});
  const auto refuse = [this, id = swap.request_id(), refusal](const Json& place) {
    Refusal told = refusal;
    if (place.is_object()) {
      told.message = fmt::format("{}: {}", place.value("where", ""), refusal.message);
      told.detail["where"] = place["where"];
    }
    queue_.on_refused(id, std::move(told), monotonic_ns());
  };
  if (offset == 0) {
    refuse(nullptr);
  } else {
    find_line(swap, offset, placed_->slot != 0, refuse);
  }
}

void Swaps::stage(const swap::Transaction& swap) {
  wire::StageRequest request;
  request.request_id = swap.request_id();
  request.source_hash = std::strtoull(swap.compiled().hash.substr(0, 16).c_str(), nullptr, 16);
  request.slot = placed_->slot;
  request.code_bytes = placed_->code_bytes;
  request.entry = placed_->entry;
  request.image_hash = placed_->image_hash;
  swap::put_terms(swap.request().terms, help_.spine.info().rate_hz, request);
  put_params(swap.request().params, swap.compiled().descriptor, request);
  stage_refused_ns_ = 0;
  const std::string& object = swap.compiled().object;
  if (!put(request.path, object) || !put(request.name, swap.compiled().law)) {
    queue_.on_refused(swap.request_id(),
                      {"path_too_long", fmt::format("{} does not fit the Spine's field", object),
                       "set LITHE_CACHE_DIR to a shorter path"},
                      monotonic_ns());
    return;
  }
  lifecycle_.measure_all();  // the counts of earlier laws must not include this one
  before_ = count_core(help_.spine.spine_pid(), help_.spine.info());
  ticket_ = help_.spine.stage(request);
  if (!ticket_) {
    queue_.on_refused(swap.request_id(), stage_refusal(wire::StageResult::busy, "the Loader does not take requests"),
                      monotonic_ns());
    return;
  }
  if (placed_->slot != 0) {
    placement_.asked(placed_->slot, *ticket_);
  }
  placed_.reset();
}

void Swaps::on_event(const wire::Event& event, std::int64_t now_ns) {
  const auto kind = static_cast<wire::EventKind>(event.kind);
  if (kind == wire::EventKind::state_not_carried) {
    return not_carried(event);
  }
  if (kind != wire::EventKind::law_committed) {
    take_commit();  // later events may be about the committed law
  }
  lifecycle_.on_event(event);
  params_.on_event(event);
  if (kind == wire::EventKind::law_retired) {
    tried_laws_.forget(event.request_id);
  }
  if (!is_head(event.request_id)) {
    come_late(event);
    return;
  }
  if (kind == wire::EventKind::law_committed) {
    commit_ = event;  // answered once telemetry shows the new law, so that the client's next `status` does too
  } else if (kind == wire::EventKind::law_staged) {
    queue_.on_staged(event.request_id, event.t_ns);
  } else if (kind == wire::EventKind::shadow_started) {
    queue_.on_shadow(event.request_id, event.t_ns);
  } else if (kind == wire::EventKind::shadow_ended) {
    shadow_ended(event, now_ns);
  } else if (kind == wire::EventKind::law_refused) {
    queue_.on_refused(event.request_id, stage_refusal(static_cast<wire::StageResult>(event.code), text_of(event.text)),
                      now_ns);
  }
}

void Swaps::shadow_ended(const wire::Event& event, std::int64_t now_ns) {
  wire::ShadowReport report{};
  ipc::ChannelReader<wire::ShadowReport> reader(help_.spine.memory().shadow);
  if (reader.read(report) && report.request_id == event.request_id) {
    queue_.note(event.request_id, "shadow", shadow_json(report));
  }
  if (event.code == 0) {
    queue_.on_refused(
        event.request_id,
        {"shadow_failed",
         fmt::format("in the shadow: {} (largest difference {:.4g} N m, tolerance {:.4g} N m)", text_of(event.text),
                     event.value, queue_.head()->request().terms.shadow_tolerance_nm),
         "the running law is unchanged; make them agree, or swap without a shadow"},
        now_ns);
  }
}

void Swaps::take_commit() {
  if (commit_) {
    queue_.on_committed(commit_->request_id, commit_->tick, commit_->code, commit_->t_ns);
  }
}

// The commit is normally known from its event. When the ring lost the event, the law id in telemetry shows it; the
// commit tick is then an estimate.
void Swaps::guess_commit(std::int64_t now_ns) {
  const swap::Transaction* head = queue_.head();
  wire::Telemetry now{};
  if (head == nullptr || !head->reached(swap::Stage::tried) || !help_.spine.latest(now)) {
    return;
  }
  const auto law = help_.spine.law(now.law_id);
  if (law && law->request_id == head->request_id()) {
    queue_.note(head->request_id(), "commit_tick_is_estimate", true);
    queue_.on_committed(head->request_id(), now.tick, now.law_id, now_ns);
  }
}

void Swaps::poll_stage(std::int64_t now_ns) {
  const swap::Transaction* head = queue_.head();
  if (head == nullptr || !ticket_) {
    return;
  }
  if (commit_) {
    wire::Telemetry now{};
    (void)help_.spine.latest(now);
    if (now.tick > commit_->tick || now_ns - commit_->t_ns > kWordsGraceNs) {
      take_commit();
    }
    return;
  }
  if (head->stage() == swap::Stage::tried) {
    const wire::StageResult result = help_.spine.poll_stage(*ticket_);
    if (result == wire::StageResult::staged && now_ns - head->stage_since_ns() > kWordsGraceNs) {
      queue_.on_staged(head->request_id(), now_ns);
    } else if (result != wire::StageResult::pending && result != wire::StageResult::staged) {
      stage_refused_ns_ = stage_refused_ns_ == 0 ? now_ns : stage_refused_ns_;
      if (now_ns - stage_refused_ns_ > kWordsGraceNs) {
        queue_.on_refused(head->request_id(), stage_refusal(result, ""), now_ns);
      }
    }
  } else if (head->reached(swap::Stage::staged) && now_ns - head->stage_since_ns() > kWordsGraceNs) {
    guess_commit(now_ns);
  }
}

}  // namespace lithe::control
