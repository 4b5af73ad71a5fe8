// SPDX-License-Identifier: Apache-2.0
// Swaps of one robot: their queue, the one that is under way (swap.cpp), and their answers and certificates.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <variant>

#include "supervisor/core/sequence.hpp"
#include "supervisor/events/event_log.hpp"
#include "supervisor/link/services/services.hpp"
#include "supervisor/link/spine/commands.hpp"
#include "supervisor/link/spine/spine_link.hpp"
#include "supervisor/swap/certificate/certificate_files.hpp"
#include "supervisor/swap/certificate/swap_state.hpp"
#include "supervisor/swap/law_lifecycle.hpp"
#include "supervisor/swap/param_changes.hpp"
#include "supervisor/swap/tried_laws.hpp"

namespace lithe::control {

// The Loader's refusal. `words`: the text of its event, empty when there was none.
Refusal stage_refusal(wire::StageResult result, const std::string& words);

// Where in its code the trial saw a law fail, in this section of it or ("") in any [bytes]; 0 = not known.
std::uint64_t offset_in(const Refusal& refusal, std::string_view section = "");

// Contract: one thread · never blocks · every submit is answered once, and has one certificate from the moment it is
// queued, also when the client leaves or the supervisor dies
class Swaps {
 public:
  using Callback = std::function<void(const Answer&)>;
  static constexpr std::size_t kMaxWaiting = 64;

  // All outlive Swaps.
  struct Helpers {
    SpineLink& spine;
    LawdLink& lawd;
    TrialLink* trial;  // nullptr: the gates are open (--ungated), laws are not tried
    Commands& commands;
    EventLog& log;
  };

  Swaps(const Helpers& helpers, CertificateFiles book, std::uint64_t first_request_id, const robot::RobotConfig& robot);

  // How a resident law did (LawLifecycle::score_of).
  Json score_of(std::uint32_t law_id) const { return lifecycle_.score_of(law_id); }
  // The text of a law of this name that ran, the newest: a file beside its certificate. Empty: not known.
  std::filesystem::path source_of(const std::string& law) const;
  // The same of a law that is loaded.
  std::filesystem::path source_of(std::uint32_t law_id) const;
  // The robot file's terms, changed by the arguments of the request.
  std::variant<SwapTerms, Refusal> read_terms(const Json& args) const;
  void submit(SwapRequest request, Callback callback, std::int64_t now_ns);
  // Parameter changes of the running law. They pass the trial too, and are recorded in the law's certificate; with
  // `dry_run` they are only tried.
  void set_params(const Json& values, bool dry_run, Callback callback, std::int64_t now_ns) {
    params_.set(values, dry_run, std::move(callback), now_ns);
  }
  void on_event(const wire::Event& event, std::int64_t now_ns);
  void serve(std::int64_t now_ns);
  // The robot stops, or the Spine has ended. A law that was committed by then is answered as committed.
  void refuse_all(const Refusal& reason, std::int64_t now_ns);
  // The last try to write certificates that wait for room on the disk; says which are lost. After refuse_all().
  void write_last_certificates(std::int64_t now_ns);
  // True while an answer in shared memory is expected, for which poll() does not wake up: call serve() every
  // millisecond then.
  bool waiting() const { return head_ && head_->swap.reached(Stage::tried); }
  bool gates_are_open() const { return help_.trial == nullptr; }
  // summary_of() the newest swap that has begun, with its verdict so far; null before the first.
  const Json& last() const { return last_; }
  // The newest parameter change that was tried, with its verdict so far; null before the first.
  const Json& last_params() const { return params_.last(); }
  // The newest law faults: [{law, kind, tick, where, function, ...}].
  const Json& law_faults() const { return lifecycle_.faults(); }
  // Folder of the certificates.
  const std::filesystem::path& records() const { return book_.folder(); }
  // Why certificates cannot be written, or which were lost; null when all are on disk.
  Json certificates_error() const;

 private:
  // A swap that waits, is under way, or timed out while the Spine had its law.
  struct Entry {
    SwapState swap;
    Callback callback;
    CertificateFiles::Page record = {};
    std::string record_lost = "";  // why there is no file; empty = there is one
  };
  // What the Spine has said about the law of the head.
  struct Heard {
    std::uint64_t ticket = 0;  // of the stage request
    std::int64_t staged_ns = 0, shadow_ns = 0;
    std::optional<wire::Event> commit;
    std::optional<wire::Event> measured;  // the end of a shadow that was not to be promoted
    bool shown = false;                   // by telemetry, so that the client's next `status` shows the law too
    std::optional<Refusal> refusal;
    std::int64_t refused_ns = 0;  // the Loader refused; its event with the reason may still come

    Stage stage() const {
      return shown || measured.has_value()          ? Stage::committed
             : commit.has_value() || shadow_ns != 0 ? Stage::shadow
             : staged_ns != 0                       ? Stage::staged
                                                    : Stage::tried;
    }
  };

  // swap.cpp: the swap at the head of the queue, from its source text to its commit.
  Sequence swap_law(SwapState& swap);
  void refuse(SwapState& swap, const Refusal& reason);
  void give_up(SwapState& swap, const Refusal& reason);
  Sequence::Reply<Compiled> compile(const SwapState& swap);
  void admitted(SwapState& swap, Compiled compiled);
  Sequence::Reply<Placed> place(const SwapState& swap);
  void placed(SwapState& swap, const Placed& where);
  Sequence::Reply<std::string> attempt(const SwapState& swap);
  TrialRequest request_of(const SwapState& swap) const;
  std::variant<std::string, Refusal> tried(SwapState& swap, const Answer& answer);
  Sequence::Reply<Json> line_of_crash(const SwapState& swap, const Refusal& refusal);
  void find_line_of_nan(const SwapState& swap, LawLifecycle::Found found);
  std::optional<Refusal> stage(SwapState& swap);
  Sequence::Until spine_reaches(Stage stage, const SwapState& swap);
  void mark_heard(SwapState& swap) const;
  void hear(const wire::Event& event);
  void shadow_ended(const wire::Event& event);
  std::optional<Refusal> long_shadow(std::int64_t now_ns) const;
  void look(std::int64_t now_ns);
  bool find_commit(std::int64_t now_ns);

  // swaps.cpp: the queue, the answers and the certificates.
  bool is_head(std::uint64_t request_id) const { return head_ && head_->swap.request_id() == request_id; }
  std::int64_t now_ns() const { return sequence_->now_ns(); }
  void supersede(const SwapRequest& newer, std::int64_t now_ns);
  void refuse_waiting(std::deque<Entry>::iterator which, const Refusal& reason, std::int64_t now_ns);
  void begin_next(std::int64_t now_ns);
  void go_on(std::int64_t now_ns);
  void settle();
  void finish(Entry entry);
  void come_late(const wire::Event& event);
  void not_carried(const wire::Event& event);
  std::deque<Entry>::iterator given_up(std::uint64_t request_id);
  void find_line(const SwapState& swap, std::uint64_t offset, bool placed, LawLifecycle::Found found);
  void locate(const SwapState& swap, std::uint32_t offset, LawLifecycle::Found found);
  void remember(const SwapState& swap);
  void keep_record(Entry& entry);
  void drop_old_sources();
  // False: it waits for room on the disk.
  bool rewrite(const SwapState& swap, const CertificateFiles::Page& record);
  void note(const SwapState& swap, const char* kind, const std::string& text);
  std::uint64_t missed_releases() const;
  std::optional<Refusal> no_shadow(const SwapTerms& terms) const;

  Helpers help_;
  CertificateFiles book_;
  LateCertificates late_;
  LawTexts sources_;
  std::string write_failed_;  // why the last certificate could not be written; empty = it was written
  Json last_ = nullptr;
  SwapTerms robots_terms_;
  LawLifecycle lifecycle_;
  TriedLaws tried_laws_;
  ParamChanges params_;
  std::uint64_t next_id_;
  std::deque<Entry> waiting_;
  std::optional<Entry> head_;         // the swap under way,
  std::optional<Sequence> sequence_;  // and where it is
  std::optional<Placed> placed_;      // its slot, until the stage request is sent
  bool lawd_can_place_ = true;        // false: it has no arena
  Heard heard_;
  CoreCounts before_;  // when the stage request was sent
  static constexpr std::size_t kMostUnconfirmed = 8;
  std::deque<Entry> unconfirmed_;  // timed out while the Spine had them, oldest first
};

}  // namespace lithe::control
