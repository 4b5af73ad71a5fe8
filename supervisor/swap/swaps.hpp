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
#include "supervisor/link/commands.hpp"
#include "supervisor/link/lawd_link.hpp"
#include "supervisor/link/spine_link.hpp"
#include "supervisor/link/trial_link.hpp"
#include "supervisor/swap/law_lifecycle.hpp"
#include "supervisor/swap/param_changes.hpp"
#include "supervisor/swap/placement.hpp"
#include "supervisor/swap/record.hpp"
#include "supervisor/swap/transaction.hpp"
#include "supervisor/swap/tried_laws.hpp"

namespace lithe::control {

// The Loader's refusal. `words`: the text of its event, empty when there was none.
swap::Refusal stage_refusal(wire::StageResult result, const std::string& words);

// Contract: one thread · never blocks · every submit is answered once, and has one certificate from the moment it is
// queued, also when the client leaves or the supervisor dies
class Swaps {
 public:
  using Callback = std::function<void(const swap::Answer&)>;
  static constexpr std::size_t kMaxWaiting = 64;

  // All outlive Swaps.
  struct Helpers {
    SpineLink& spine;
    LawdLink& lawd;
    TrialLink* trial;  // nullptr: the gates are off (--ungated), laws are not tried
    Commands& commands;
    EventLog& log;
  };

  Swaps(const Helpers& helpers, swap::RecordBook book, std::uint64_t first_request_id, const robot::RobotConfig& robot);

  // The robot file's terms, changed by the arguments of the request.
  std::variant<swap::Terms, swap::Refusal> read_terms(const swap::Json& args) const;
  void submit(swap::Request request, Callback callback, std::int64_t now_ns);
  // Parameter changes of the running law. They pass the trial too, and are recorded in the law's certificate.
  void set_params(const swap::Json& values, Callback callback, std::int64_t now_ns) {
    params_.set(values, std::move(callback), now_ns);
  }
  void on_event(const wire::Event& event, std::int64_t now_ns);
  void serve(std::int64_t now_ns);
  // The robot stops, or the Spine has ended. A law that was committed by then is answered as committed.
  void refuse_all(const swap::Refusal& reason, std::int64_t now_ns);
  // The last try to write certificates that wait for room on the disk; says which are lost. After refuse_all().
  void write_last_records(std::int64_t now_ns);
  // True while an answer in shared memory is expected, for which poll() does not wake up: call serve() every
  // millisecond then.
  bool waiting() const { return head_ && head_->swap.reached(swap::Stage::tried); }
  bool gates_are_open() const { return help_.trial == nullptr; }
  // summary_of() the newest swap that has begun, with its verdict so far; null before the first.
  const swap::Json& last() const { return last_; }
  // The newest parameter change that was tried, with its verdict so far; null before the first.
  const swap::Json& last_params() const { return params_.last(); }
  // The newest law faults: [{law, kind, tick, where, function, ...}].
  const swap::Json& law_faults() const { return lifecycle_.faults(); }
  // Folder of the certificates.
  const std::filesystem::path& records() const { return book_.folder(); }
  // Why certificates cannot be written, or which were lost; null when all are on disk.
  swap::Json records_trouble() const;

 private:
  // A swap that waits, is under way, or timed out while the Spine had its law.
  struct Entry {
    swap::Transaction swap;
    Callback callback;
    swap::RecordBook::Page record = {};
    std::string record_lost = "";  // why there is no file; empty = there is one
  };
  // What the Spine has said about the law of the head.
  struct Heard {
    std::uint64_t ticket = 0;  // of the stage request
    std::int64_t staged_ns = 0, shadow_ns = 0;
    std::optional<wire::Event> commit;
    bool shown = false;  // by telemetry, so that the client's next `status` shows the law too
    std::optional<swap::Refusal> refusal;
    std::int64_t refused_ns = 0;  // the Loader refused; its event with the reason may still come

    swap::Stage stage() const {
      return shown                                  ? swap::Stage::committed
             : commit.has_value() || shadow_ns != 0 ? swap::Stage::shadow
             : staged_ns != 0                       ? swap::Stage::staged
                                                    : swap::Stage::tried;
    }
  };

  // swap.cpp: the swap at the head of the queue, from its source text to its commit.
  Sequence swap_law(swap::Transaction& swap);
  void refuse(swap::Transaction& swap, const swap::Refusal& reason);
  void give_up(swap::Transaction& swap, const swap::Refusal& reason);
  Sequence::Reply<swap::Compiled> compile(const swap::Transaction& swap);
  void admitted(swap::Transaction& swap, swap::Compiled compiled);
  Sequence::Reply<Placed> place(const swap::Transaction& swap);
  void placed(swap::Transaction& swap, const Placed& where);
  Sequence::Reply<std::string> attempt(const swap::Transaction& swap);
  TrialOrder order_of(const swap::Transaction& swap) const;
  std::variant<std::string, swap::Refusal> tried(swap::Transaction& swap, const swap::Answer& answer);
  Sequence::Reply<swap::Json> line_of_crash(const swap::Transaction& swap, const swap::Refusal& refusal);
  std::optional<swap::Refusal> stage(swap::Transaction& swap);
  Sequence::Until spine_reaches(swap::Stage stage, const swap::Transaction& swap);
  void mark_heard(swap::Transaction& swap) const;

  // swap_events.cpp: what the Spine says.
  void look(std::int64_t now_ns);
  bool find_commit(std::int64_t now_ns);
  void hear(const wire::Event& event);
  void shadow_ended(const wire::Event& event);
  void come_late(const wire::Event& event);
  void not_carried(const wire::Event& event);

  // swaps.cpp: the queue, the answers and the certificates.
  bool is_head(std::uint64_t request_id) const { return head_ && head_->swap.request_id() == request_id; }
  std::int64_t now_ns() const { return sequence_->now_ns(); }
  void supersede(const swap::Request& newer, std::int64_t now_ns);
  void begin_next(std::int64_t now_ns);
  void go_on(std::int64_t now_ns);
  void settle();
  void finish(Entry entry);
  void find_line(const swap::Transaction& swap, std::uint64_t offset, bool placed, LawLifecycle::Found found);
  void locate(const swap::Transaction& swap, std::uint32_t offset, LawLifecycle::Found found);
  void remember(const swap::Transaction& swap);
  void keep_record(Entry& entry);
  void rewrite(const swap::Transaction& swap, const swap::RecordBook::Page& record);
  void note(const swap::Transaction& swap, const char* kind, const std::string& text);
  void log(std::uint64_t request_id, const char* kind, const std::string& text);
  std::uint64_t missed_releases() const;
  std::optional<swap::Refusal> no_shadow(const swap::Terms& terms) const;

  Helpers help_;
  Placement placement_;
  swap::RecordBook book_;
  swap::LateRecords late_;
  std::string write_failed_;  // why the last certificate could not be written; empty = it was written
  swap::Json last_ = nullptr;
  swap::Terms robots_terms_;
  LawLifecycle lifecycle_;
  TriedLaws tried_laws_;
  ParamChanges params_;
  std::uint64_t next_id_;
  std::deque<Entry> waiting_;
  std::optional<Entry> head_;         // the swap under way,
  std::optional<Sequence> sequence_;  // and where it is
  std::optional<Placed> placed_;      // its slot, until the stage request is sent
  Heard heard_;
  CoreCounts before_;  // when the stage request was sent
  static constexpr std::size_t kMostUnconfirmed = 8;
  std::deque<Entry> unconfirmed_;  // timed out while the Spine had them, oldest first
};

}  // namespace lithe::control
