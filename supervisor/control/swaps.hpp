// SPDX-License-Identifier: Apache-2.0
// Drives the swap queue: compile service, Spine, event log and records on one side, clients on the other.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <variant>

#include "supervisor/control/commands.hpp"
#include "supervisor/control/event_log.hpp"
#include "supervisor/control/lawd_link.hpp"
#include "supervisor/control/placement.hpp"
#include "supervisor/control/spine_link.hpp"
#include "supervisor/swap/queue.hpp"
#include "supervisor/swap/record.hpp"
#include "supervisor/swap/terms.hpp"

namespace lithe::control {

// Contract: one thread · never blocks · every submit is answered once, and leaves one record from the moment it
// is queued: a client that goes away, or a supervisor that dies, does not take it along.
class Swaps {
 public:
  using Callback = std::function<void(const swap::Answer&)>;

  Swaps(SpineLink& spine, LawdLink& lawd, Commands& commands, EventLog& log, swap::RecordBook book,
        std::uint64_t first_request_id, const robot::RobotConfig& robot);

  // The terms that the arguments of a request ask for, on top of the robot's own.
  std::variant<swap::Terms, swap::Refusal> read_terms(const swap::Json& args) const;

  void submit(swap::Request request, Callback callback, std::int64_t now_ns);
  void on_event(const wire::Event& event, std::int64_t now_ns);
  void serve(std::int64_t now_ns);
  void refuse_all(const swap::Refusal& reason, std::int64_t now_ns) { queue_.refuse_all(reason, now_ns); }
  // True while the Spine has something to say that no descriptor announces: serve() every millisecond then.
  bool waiting() const { return queue_.head() != nullptr && queue_.head()->stage() != swap::Stage::submitted; }

 private:
  void compile(const swap::Transaction& swap);
  void compiled(std::uint64_t request_id, const swap::Answer& answer);
  void placed(std::uint64_t request_id, swap::Compiled compiled, const Placed& where);
  void stage(const swap::Transaction& swap);
  void poll_stage(std::int64_t now_ns);
  void finish(const swap::Transaction& swap);
  void keep_record(const swap::Transaction& swap);
  void note(const swap::Transaction& swap, const char* kind, const std::string& text);
  std::uint64_t missed_releases() const;
  std::optional<swap::Refusal> no_shadow(const swap::Terms& terms) const;

  SpineLink& spine_;
  LawdLink& lawd_;
  Placement placement_;
  Commands& commands_;
  EventLog& log_;
  swap::RecordBook book_;
  swap::Terms robots_terms_;
  swap::Queue queue_;
  struct Waiting {
    Callback callback;
    std::filesystem::path record;  // empty: it could not be written
  };
  std::map<std::uint64_t, Waiting> waiting_;
  Placed placed_;                        // where the head of the queue lies
  std::optional<std::uint64_t> ticket_;  // of the stage request under way
  std::optional<wire::Event> commit_;    // seen, not yet answered
  std::int64_t stage_refused_ns_ = 0;    // the Loader said no; its event may still bring the words
};

}  // namespace lithe::control
