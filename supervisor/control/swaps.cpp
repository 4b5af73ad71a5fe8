// SPDX-License-Identifier: Apache-2.0
#include "supervisor/control/swaps.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cstdlib>
#include <cstring>
#include <utility>

#include "spine/core/time.hpp"

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

// The first parameter that the compiled law does not have or does not allow.
std::optional<Refusal> wrong_param(const Json& params, const Json& law) {
  for (const auto& [name, value] : params.items()) {
    const Json known = law.value("params", Json::array());
    const auto found = std::find_if(known.begin(), known.end(),
                                    [&name = name](const Json& each) { return each.value("name", "") == name; });
    if (found == known.end()) {
      return Refusal{"unknown_param", fmt::format("the new law has no parameter '{}'", name), "leave it out"};
    }
    if (!value.is_number() || !(value >= (*found)["min"]) || !(value <= (*found)["max"])) {
      return Refusal{"refused_range",
                     fmt::format("{} = {} is outside [{}, {}]", name, value.dump(), (*found)["min"].dump(),
                                 (*found)["max"].dump()),
                     "the running law is unchanged; choose a value inside the range"};
    }
  }
  return std::nullopt;
}

Refusal stage_refusal(wire::StageResult result, const std::string& words) {
  const std::string code(to_string(result));
  const char* next = result == wire::StageResult::busy || result == wire::StageResult::slots_full
                         ? "another swap is under way in the Spine; try again"
                         : "the running law is unchanged; lithe law check tells more";
  return {code, words.empty() ? fmt::format("the Loader refused the law: {}", code) : words, next};
}

}  // namespace

Swaps::Swaps(SpineLink& spine, LawdLink& lawd, Commands& commands, EventLog& log, swap::RecordBook book,
             std::uint64_t first_request_id, const robot::RobotConfig& robot)
    : spine_(spine),
      lawd_(lawd),
      placement_(spine, lawd),
      commands_(commands),
      log_(log),
      book_(std::move(book)),
      robots_terms_(swap::terms_of(robot, spine.info().rate_hz)),
      queue_({[this](const swap::Transaction& each) { compile(each); },
              [this](const swap::Transaction& each) { stage(each); }, [this] { return missed_releases(); },
              [this](const swap::Transaction& each) { finish(each); }},
             first_request_id, {2 * LawdLink::kCompileTimeoutNs}) {}

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
  waiting_[id] = {std::move(callback), {}};
  keep_record(*queue_.newest());
  queue_.step(now_ns);
}

std::variant<swap::Terms, Refusal> Swaps::read_terms(const Json& args) const {
  for (const auto& [name, value] : args.items()) {
    if (!swap::is_term(name) && name != "path" && name != "source" && name != "name" && name != "params") {
      return Refusal{"usage", fmt::format("swap has no argument '{}'", name), "see docs/reference/verbs.md"};
    }
  }
  return swap::read_terms(args, robots_terms_, spine_.info().rate_hz);
}

// A shadow needs a law to run beside.
std::optional<Refusal> Swaps::no_shadow(const swap::Terms& terms) const {
  wire::Telemetry now{};
  (void)spine_.latest(now);
  const auto mode = static_cast<wire::Mode>(now.mode);
  if (terms.shadow_s == 0 || (now.law_id != 0 && (mode == wire::Mode::active || mode == wire::Mode::hold))) {
    return std::nullopt;
  }
  return Refusal{"refused_mode",
                 fmt::format("a shadow runs beside the active law, and in mode {} none runs", to_string(mode)),
                 "arm first: lithe arm; or swap without a shadow"};
}

void Swaps::keep_record(const swap::Transaction& swap) {
  std::filesystem::path& record = waiting_[swap.request_id()].record;
  const Json certificate = swap.certificate();
  if (!record.empty()) {
    if (const auto written = swap::RecordBook::rewrite(record, certificate); !written) {
      spdlog::warn("{}", written.message());
    }
  } else if (const auto path = book_.write(certificate)) {
    record = *path;
  } else {
    spdlog::warn("{}", path.message());
  }
}

std::uint64_t Swaps::missed_releases() const {
  wire::Telemetry now{};
  (void)spine_.latest(now);
  return now.missed_releases;
}

void Swaps::note(const swap::Transaction& swap, const char* kind, const std::string& text) {
  log_.add({{"t_ns", monotonic_ns()}, {"tick", 0}, {"kind", kind}, {"request_id", swap.request_id()}, {"text", text}});
  spdlog::info("{}: {}", kind, text);
}

void Swaps::compile(const swap::Transaction& swap) {
  note(swap, "swap_submitted", swap.request().name);
  const std::uint64_t id = swap.request_id();
  lawd_.compile(
      {swap.request().name, swap.request().source, swap.request().terms.budget_ns()},
      [this, id](const Answer& answer) { compiled(id, answer); }, monotonic_ns());
}

void Swaps::compiled(std::uint64_t request_id, const Answer& answer) {
  const std::int64_t now_ns = monotonic_ns();
  const swap::Transaction* head = queue_.head();
  if (head == nullptr || head->request_id() != request_id) {
    return;
  }
  if (const auto* refusal = std::get_if<Refusal>(&answer)) {
    queue_.on_refused(request_id, *refusal, now_ns);
    return;
  }
  const Json& result = std::get<Json>(answer);
  const Json law = result.value("law", Json::object());
  if (const auto wrong = wrong_param(head->request().params, law)) {
    queue_.on_refused(request_id, *wrong, now_ns);
    return;
  }
  swap::Compiled compiled{result.value("object", ""),    result.value("hash", ""),        law.value("name", ""),
                          result.value("cached", false), result.value("compile_ms", 0.0), law};
  note(*head, "swap_compiled",
       fmt::format("{} in {:.0f} ms{}", compiled.law, compiled.compile_ms, compiled.cached ? " (cached)" : ""));
  const std::string hash = compiled.hash;
  placement_.place(
      hash,
      [this, request_id, compiled = std::move(compiled)](const std::variant<Placed, Refusal>& where) {
        if (const auto* refusal = std::get_if<Refusal>(&where)) {
          queue_.on_refused(request_id, *refusal, monotonic_ns());
        } else {
          placed(request_id, compiled, std::get<Placed>(where));
        }
      },
      now_ns);
}

void Swaps::placed(std::uint64_t request_id, swap::Compiled compiled, const Placed& where) {
  const swap::Transaction* head = queue_.head();
  if (head == nullptr || head->request_id() != request_id) {
    placement_.forget(where.slot);  // it was given up meanwhile
    return;
  }
  if (where.slot != 0) {
    note(*head, "swap_placed",
         fmt::format("slot {}, {} bytes in {:.1f} ms", where.slot, where.code_bytes, where.place_ms));
  }
  placed_ = where;
  queue_.on_compiled(request_id, std::move(compiled), monotonic_ns());
}

void Swaps::stage(const swap::Transaction& swap) {
  wire::StageRequest request;
  request.request_id = swap.request_id();
  request.source_hash = std::strtoull(swap.compiled().hash.substr(0, 16).c_str(), nullptr, 16);
  request.slot = placed_.slot;
  request.code_bytes = placed_.code_bytes;
  request.entry = placed_.entry;
  request.image_hash = placed_.image_hash;
  swap::put_terms(swap.request().terms, spine_.info().rate_hz, request);
  ticket_.reset();
  commit_.reset();
  stage_refused_ns_ = 0;
  const std::string& object = swap.compiled().object;
  if (!put(request.path, object) || !put(request.name, swap.compiled().law)) {
    placement_.forget(placed_.slot);
    queue_.on_refused(swap.request_id(),
                      {"path_too_long", fmt::format("{} does not fit the Spine's field", object),
                       "set LITHE_CACHE_DIR to a shorter path"},
                      monotonic_ns());
    return;
  }
  ticket_ = spine_.stage(request);
  if (ticket_) {
    placement_.asked(placed_.slot, *ticket_);
  } else {
    placement_.forget(placed_.slot);
    queue_.on_refused(swap.request_id(), stage_refusal(wire::StageResult::busy, "the Loader does not take requests"),
                      monotonic_ns());
  }
}

void Swaps::on_event(const wire::Event& event, std::int64_t now_ns) {
  const swap::Transaction* head = queue_.head();
  if (head == nullptr || event.request_id != head->request_id()) {
    return;
  }
  const auto kind = static_cast<wire::EventKind>(event.kind);
  if (kind == wire::EventKind::law_committed) {
    commit_ = event;  // answered once telemetry shows the new law, so that the client's next look does too
  } else if (kind == wire::EventKind::law_staged) {
    queue_.on_staged(event.request_id, event.t_ns);
  } else if (kind == wire::EventKind::law_refused) {
    queue_.on_refused(event.request_id, stage_refusal(static_cast<wire::StageResult>(event.code), text_of(event.text)),
                      now_ns);
  }
}

void Swaps::poll_stage(std::int64_t now_ns) {
  const swap::Transaction* head = queue_.head();
  if (head == nullptr || !ticket_) {
    return;
  }
  wire::Telemetry now{};
  const bool known = spine_.latest(now);
  if (commit_) {
    if (now.tick > commit_->tick || now_ns - commit_->t_ns > kWordsGraceNs) {
      queue_.on_committed(commit_->request_id, commit_->tick, commit_->code, commit_->t_ns);
    }
    return;
  }
  if (head->stage() == swap::Stage::compiled) {
    const wire::StageResult result = spine_.poll_stage(*ticket_);
    if (result == wire::StageResult::staged && now_ns - head->stage_since_ns() > kWordsGraceNs) {
      queue_.on_staged(head->request_id(), now_ns);
    } else if (result != wire::StageResult::pending && result != wire::StageResult::staged) {
      stage_refused_ns_ = stage_refused_ns_ == 0 ? now_ns : stage_refused_ns_;
      if (now_ns - stage_refused_ns_ > kWordsGraceNs) {
        queue_.on_refused(head->request_id(), stage_refusal(result, ""), now_ns);
      }
    }
  } else if (head->stage() == swap::Stage::staged) {
    // The event says it first; should the ring have lost it, the running law itself tells.
    const auto law = known ? spine_.law(now.law_id) : std::nullopt;
    if (law && law->request_id == head->request_id() && now_ns - head->stage_since_ns() > kWordsGraceNs) {
      queue_.on_committed(head->request_id(), now.tick, now.law_id, now_ns);
    }
  }
}

void Swaps::serve(std::int64_t now_ns) {
  poll_stage(now_ns);
  queue_.step(now_ns);
}

void Swaps::finish(const swap::Transaction& swap) {
  ticket_.reset();
  keep_record(swap);
  const Json certificate = swap.certificate();
  const Callback callback = std::move(waiting_[swap.request_id()].callback);
  waiting_.erase(swap.request_id());
  if (swap.refusal()) {
    note(swap, swap.confirmed() ? "swap_refused" : "swap_not_confirmed",
         fmt::format("{}: {}", swap.request().name, swap.refusal()->message));
    Refusal refusal = *swap.refusal();
    if (refusal.detail.is_null()) {
      refusal.detail = Json::object();
    }
    refusal.detail["swap"] = certificate;
    refusal.detail["swap"].erase("error");
    callback(refusal);
  } else if (swap.request().params.empty()) {
    callback(certificate);
  } else {
    commands_.set_params(
        swap.request().params,
        [certificate, callback](const Answer& answer) {
          if (const auto* refusal = std::get_if<Refusal>(&answer)) {
            callback(Refusal{refusal->code,
                             (refusal->code == "timeout" ? "the law runs; its parameters: "
                                                         : "the law runs, its parameters do not: ") +
                                 refusal->message,
                             refusal->next,
                             {{"swap", certificate}}});
          } else {
            callback(certificate);
          }
        },
        monotonic_ns(), certificate.value("law_id", std::uint32_t{0}));
  }
}

}  // namespace lithe::control
