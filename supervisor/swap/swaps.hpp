// SPDX-License-Identifier: Apache-2.0
// Runs the swap queue: connects clients with the compile service, the trial, the Spine, the event log and the
// certificates.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <variant>

#include "supervisor/events/event_log.hpp"
#include "supervisor/link/commands.hpp"
#include "supervisor/link/lawd_link.hpp"
#include "supervisor/link/spine_link.hpp"
#include "supervisor/link/trial_link.hpp"
#include "supervisor/swap/late.hpp"
#include "supervisor/swap/law_lifecycle.hpp"
#include "supervisor/swap/param_changes.hpp"
#include "supervisor/swap/placement.hpp"
#include "supervisor/swap/queue.hpp"
#include "supervisor/swap/record.hpp"
#include "supervisor/swap/terms.hpp"
#include "supervisor/swap/tried_laws.hpp"

namespace lithe::control {

// Contract: one thread · never blocks · every submit is answered once, and has one certificate from the moment it is
// queued, also when the client leaves or the supervisor dies
class Swaps {
 public:
  using Callback = std::function<void(const swap::Answer&)>;

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
  // True while an answer in shared memory is expected, for which poll() does not wake up: call serve() every
  // millisecond then.
  bool waiting() const { return queue_.head() != nullptr && queue_.head()->reached(swap::Stage::tried); }
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
  // The steps of the swap at the head of the queue, in this order.
  void compile(const swap::Transaction& swap);
  void compiled(std::uint64_t request_id, const swap::Answer& answer);
  void place(const swap::Transaction& swap);
  void placed(std::uint64_t request_id, const std::variant<Placed, swap::Refusal>& where);
  void attempt(const swap::Transaction& swap);
  void tried(std::uint64_t request_id, const swap::Answer& answer);
  TrialOrder order_of(const swap::Transaction& swap) const;
  void compare(swap::Json& report) const;
  void stage(const swap::Transaction& swap);
  void poll_stage(std::int64_t now_ns);
  void take_commit();
  void guess_commit(std::int64_t now_ns);
  void refuse_with_line(const swap::Transaction& swap, const swap::Refusal& refusal);
  void find_line(const swap::Transaction& swap, std::uint64_t offset, bool placed, LawLifecycle::Found found);
  void locate(const swap::Transaction& swap, std::uint32_t offset, LawLifecycle::Found found);
  void shadow_ended(const wire::Event& event, std::int64_t now_ns);
  void come_late(const wire::Event& event);
  void not_carried(const wire::Event& event);
  void finish(swap::Transaction&& swap);

  bool is_head(std::uint64_t request_id) const;
  void give_slot_back();
  void remember(const swap::Transaction& swap);
  void keep_record(const swap::Transaction& swap);
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
  swap::Queue queue_;
  LawLifecycle lifecycle_;
  TriedLaws tried_laws_;
  ParamChanges params_;
  struct Waiting {
    Callback callback;
    swap::RecordBook::Page record;
    std::string record_lost;  // why there is no file; empty = there is one
  };
  std::map<std::uint64_t, Waiting> waiting_;
  struct Unconfirmed {
    swap::Transaction swap;
    swap::RecordBook::Page record;
  };
  static constexpr std::size_t kMostUnconfirmed = 8;
  std::deque<Unconfirmed> unconfirmed_;  // timed out while the Spine had them, oldest first
  std::optional<Placed> placed_;         // slot of the head of the queue, until the stage request is sent
  std::optional<std::uint64_t> ticket_;  // of the pending stage request
  std::optional<wire::Event> commit_;    // seen, not yet answered
  CoreCounts before_;                    // when the stage request was sent
  std::int64_t stage_refused_ns_ = 0;    // the Loader refused; its event with the reason may still come
};

}  // namespace lithe::control
