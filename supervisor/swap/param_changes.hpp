// SPDX-License-Identifier: Apache-2.0
// Parameter values of laws: those that a swap sets, and changes to the running law's values. A change is tried like a
// swap, set in one tick, and followed until it is confirmed.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <string>

#include "spine/robot/config.hpp"
#include "supervisor/events/event_log.hpp"
#include "supervisor/link/services/services.hpp"
#include "supervisor/link/spine/commands.hpp"
#include "supervisor/swap/certificate/swap_state.hpp"
#include "supervisor/swap/tried_laws.hpp"

namespace lithe::control {

// The first parameter that the compiled law does not have or does not allow. `law`: its descriptor, as lawd gives it.
std::optional<Refusal> wrong_param(const Json& params, const Json& law);

// The value of each parameter of a law, in its own order: as asked for, else as compiled.
Json all_params(const Json& params, const Json& law);

// The parameter values by index, as the Spine takes them.
// Contract: wrong_param() found nothing
void put_params(const Json& params, const Json& law, wire::StageRequest& request);

// Handles one change at a time, on top of the values that are in force then. Values that fail the trial never reach the
// Spine.
// Contract: one thread · never blocks · every set() is answered once
class ParamChanges {
 public:
  using Callback = std::function<void(const Answer&)>;
  // Called when the list of a law's parameter changes has changed. It goes into the certificate of the swap that
  // committed the law.
  using Keep = std::function<void(std::uint64_t request_id, const Json& changes)>;
  static constexpr std::size_t kMostWaiting = 64;
  static constexpr std::size_t kMostKept = 16;  // of each law, the newest

  // All outlive ParamChanges.
  struct Helpers {
    const SpineLink& spine;
    TrialLink* trial;  // nullptr: the gates are open (--ungated), nothing is tried
    Commands& commands;
    EventLog& log;
    TriedLaws& laws;
  };

  ParamChanges(const Helpers& helpers, SwapTerms robots_terms, Keep keep)
      : help_(helpers), robots_terms_(robots_terms), keep_(std::move(keep)) {}

  // Answers {"change" (its number), "trial_ms", "warnings"} once the values are in force. Refused with
  // trial_failed: the old values stay.
  void set(const Json& values, bool dry_run, Callback callback, std::int64_t now_ns);
  void on_event(const wire::Event& event);
  void refuse_all(const Refusal& reason);
  // The newest change that was tried, with its law; null before the first.
  const Json& last() const { return last_; }

 private:
  struct Change {
    std::uint64_t number;
    RunningLaw law;  // at the request; its values are read again when the turn comes
    Json values;
    wire::Command command;
    Callback callback;
    Json record = Json::object();
    Json trial = Json::object();  // the report of the trial
    std::uint64_t command_id = 0;
    bool dry_run = false;  // it ends after the trial, and is kept nowhere
  };
  struct Past {
    std::uint64_t request_id = 0;
    std::map<std::uint64_t, Json> records;  // by number, so oldest first
  };

  static Json result_of(const Change& change);
  Change* head(std::uint64_t number);
  void begin();
  void tried(std::uint64_t number, const Answer& answer);
  void send(Change& change);
  void answered(std::uint64_t number, const Answer& answer);
  void applied(const wire::Event& event);
  void settle(const Answer& answer);
  void refuse(Change& change, const Refusal& refusal);
  void keep(Change& change, const char* verdict);
  void judge_open(std::uint32_t law_id, const std::string& verdict, const std::string& reason,
                  bool newest_only = false);
  void tell(const Past& past);
  TrialRequest request_otherwise() const;

  Helpers help_;
  SwapTerms robots_terms_;
  Keep keep_;
  std::uint64_t next_number_ = 1;
  std::deque<Change> waiting_;          // the first one is being handled
  std::map<std::uint32_t, Past> past_;  // by law
  Json last_ = nullptr;
};

}  // namespace lithe::control
