// SPDX-License-Identifier: Apache-2.0
// One swap, from the request to the day its law leaves the Spine. Pure bookkeeping: no clock, no file, no process.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/core/answer.hpp"
#include "supervisor/swap/terms.hpp"

namespace lithe::swap {

// submitted -> compiled -> admitted -> placed -> tried -> staged -> (shadow) -> committed -> (unproven) -> (confirmed)
// -> (rolled_back) -> retired, or refused from anywhere before committed. unproven: the time of the probation is over,
// but the robot has not moved enough to judge by.
enum class Stage {
  submitted,
  compiled,
  admitted,
  placed,
  tried,
  staged,
  shadow,
  committed,
  unproven,
  confirmed,
  rolled_back,
  retired,
  refused
};

const char* to_string(Stage stage);

// What a client asked for.
struct Request {
  std::string name;              // file name shown in diagnostics
  std::string source;            // C++ text of one law
  Json params = Json::object();  // name -> value, in its trial and in force on its first tick
  Terms terms = {};
  std::uint64_t client = 0;  // 0 = nobody who could ask again
  bool supersede = false;    // takes the place of this client's older request of the same name, if that still waits
};

// What the compile service made of it.
struct Compiled {
  std::string object;  // path of the shared object
  std::string hash;    // SHA-256 of source, contract and flags
  std::string law;     // the name the law gave itself
  bool cached = false;
  double compile_ms = 0.0;
  std::int64_t admission_ns = 0;     // of the time it took: what the gates needed
  Json descriptor = Json::object();  // params, state fields and probes of the law
  Json facts = Json::object();       // for the certificate: hash of the object, toolchain, gates
};

// Contract: one thread · every transition checks the order and returns false, changing nothing, when it is not legal ·
// times are read by several processes; one that lies before its predecessor counts as equal to it.
class Transaction {
 public:
  struct Step {
    Stage stage;
    std::int64_t t_ns;
    std::string reason;
  };

  Transaction(std::uint64_t request_id, Request request, std::int64_t now_ns);

  bool mark_started(std::int64_t now_ns);
  bool mark_compiled(Compiled compiled, std::int64_t now_ns);
  // Stages that bring nothing but their time and a reason: all but compiled, committed and refused.
  bool mark(Stage stage, const std::string& reason, std::int64_t now_ns);
  bool mark_committed(std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns);
  // Who had to decide said no.
  bool mark_refused(Refusal reason, std::int64_t now_ns);
  // Nobody waits any longer: it took too long, the robot stops, or its Spine is gone. A law that the Spine was asked
  // for may be committed all the same; mark_committed() and mark_refused() are legal until one of them has told.
  bool mark_given_up(Refusal reason, std::int64_t now_ns);

  // Releases the Spine had missed when the swap began and when it ended: what the swap may have cost.
  void note_missed_before(std::uint64_t missed) { missed_before_ = missed; }
  void note_missed_after(std::uint64_t missed) { missed_after_ = missed; }
  // A section of the certificate: what a stage found out.
  void note(const std::string& section, Json what) { sections_[section] = std::move(what); }

  std::uint64_t request_id() const { return request_id_; }
  const Request& request() const { return request_; }
  const Compiled& compiled() const { return compiled_; }
  std::uint32_t law_id() const { return law_id_; }  // 0 before the commit
  std::uint64_t commit_tick() const { return commit_tick_; }
  Stage stage() const { return steps_.back().stage; }
  bool finished() const { return stage() >= Stage::committed; }
  bool reached(Stage stage) const { return time_of(stage) != 0; }
  const std::optional<Refusal>& refusal() const { return refusal_; }
  // False for a swap that was given up while the Spine had it: the law may still be committed.
  bool outcome_is_known() const;
  std::int64_t stage_since_ns() const { return stage_since_ns_; }

  // submitted, refused, not_confirmed, committed, unproven, confirmed or rolled_back: the last three of what became of
  // the law.
  const char* verdict() const;
  // Who, what, when, and what every stage found out. Times are CLOCK_MONOTONIC nanoseconds.
  Json certificate() const;

 private:
  bool enter(Stage stage, const std::string& reason, std::int64_t now_ns);
  void reopen();
  std::int64_t time_of(Stage stage) const;  // 0 = not reached
  double ms_between(Stage from, Stage to) const;
  Json split_ms() const;
  Json times_ns() const;

  std::uint64_t request_id_;
  Request request_;
  Compiled compiled_;
  std::vector<Step> steps_;  // never empty
  std::int64_t started_ns_ = 0;
  std::int64_t stage_since_ns_;
  std::uint64_t commit_tick_ = 0;
  std::uint32_t law_id_ = 0;
  std::uint64_t missed_before_ = 0;
  std::uint64_t missed_after_ = 0;
  std::optional<Refusal> refusal_;
  bool given_up_ = false;
  Json sections_ = Json::object();
};

}  // namespace lithe::swap
