// SPDX-License-Identifier: Apache-2.0
// State of one swap, from the request until its law leaves the Spine, and its certificate. No clock, no file, no
// process.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

// The terms of a swap: from the robot file, changed by the request.
struct SwapTerms {
  double blend_s = 0.0;              // from the old law's torque to the new one's; 0 = the slew bound alone
  double probation_s = 0.0;          // automatic rollback for so long; 0 = none
  double error_ratio = 0.0;          // of the tracking error to the largest before; 0 = tracking is not judged
  double shadow_s = 0.0;             // runs in the shadow of the active law first; 0 = no shadow
  double shadow_tolerance_nm = 0.0;  // largest accepted difference of a torque
  double budget_us = 0.0;            // of one step
  double box_ms = 150.0;             // processor time of the trial
  bool promote = true;               // false: its shadow is measured, and it never commits

  std::uint32_t budget_ns() const { return static_cast<std::uint32_t>(budget_us * 1e3); }
  Json to_json() const;
};

// The robot file's terms. The default shadow tolerance is a tenth of the smallest torque limit.
SwapTerms terms_of(const robot::RobotConfig& robot, double rate_hz);

// With `fenced` (true for agents) none may be looser than the robot file's.
// The arguments of a request that are terms: blend_s probation_s error_ratio shadow_s shadow_tolerance_nm budget_us
// box_ms promote. Others are ignored. A Refusal names the argument, its range and what it is for.
std::variant<SwapTerms, Refusal> read_terms(const Json& args, const SwapTerms& robot, double rate_hz);
bool is_term(const std::string& argument);

// The same in the Spine's units (ticks).
void put_terms(const SwapTerms& terms, double rate_hz, wire::StageRequest& request);

//   submitted -> compiled -> admitted -> placed -> tried -> staged -> (shadow) -> committed
//   committed -> (unproven) -> confirmed or rolled_back -> retired
//   any stage before committed -> refused
//   shadow -> measured: with promote = false it ends so, and the running law goes on
// unproven: the duration of the probation is over, but the robot has not moved enough to judge the law.
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
  refused,
  measured
};

const char* to_string(Stage stage);

// The client's request.
struct SwapRequest {
  std::string name;              // file name shown in diagnostics
  std::string source;            // C++ text of one law
  Json params = Json::object();  // name -> value, in its trial and in force on its first tick
  SwapTerms terms = {};
  std::uint64_t client = 0;  // 0 = no client
  bool supersede = false;    // replaces this client's waiting request of the same name
  bool dry_run = false;      // ends, refused, when the trial has passed
};

// The result of the compile service.
struct Compiled {
  std::string object;  // path of the shared object
  std::string hash;    // SHA-256 of source, contract and flags
  std::string law;     // the law's own name
  bool cached = false;
  double compile_ms = 0.0;
  std::int64_t admission_ns = 0;     // the part of the time that the gates took
  Json descriptor = Json::object();  // params, state fields and probes of the law
  Json facts = Json::object();       // for the certificate: hash of the object, toolchain, gates
};

// The same from the answer of the compile service.
Compiled compiled_of(const Json& answer);

// Contract: one thread · every transition checks the order and returns false, changing nothing, when it is not legal ·
// times are read by several processes; one that lies before its predecessor counts as equal to it.
class SwapState {
 public:
  struct Step {
    Stage stage;
    std::int64_t t_ns;
    std::string reason;
  };

  SwapState(std::uint64_t request_id, SwapRequest request, std::int64_t now_ns);

  bool mark_started(std::int64_t now_ns);
  bool mark_compiled(Compiled compiled, std::int64_t now_ns);
  // For stages that have only a time and a reason: all but compiled, committed and refused.
  bool mark(Stage stage, const std::string& reason, std::int64_t now_ns);
  bool mark_committed(std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns);
  // A stage refused the swap.
  bool mark_refused(Refusal reason, std::int64_t now_ns);
  // The swap is given up: timeout, the robot stops, or its Spine has ended. When the Spine already has the law it may
  // still be committed; mark_committed() and mark_refused() stay legal until one of them is called.
  bool mark_given_up(Refusal reason, std::int64_t now_ns);

  // The Spine's count of missed releases at the start and the end of the swap.
  void note_missed_before(std::uint64_t missed) { missed_before_ = missed; }
  void note_missed_after(std::uint64_t missed) { missed_after_ = missed; }
  // Sets a section of the certificate: the findings of a stage.
  void note(const std::string& section, Json what) { sections_[section] = std::move(what); }

  std::uint64_t request_id() const { return request_id_; }
  const SwapRequest& request() const { return request_; }
  const Compiled& compiled() const { return compiled_; }
  std::uint32_t law_id() const { return law_id_; }  // 0 before the commit
  std::uint64_t commit_tick() const { return commit_tick_; }
  Stage stage() const { return steps_.back().stage; }
  bool finished() const { return stage() >= Stage::committed; }
  bool reached(Stage stage) const { return time_of(stage) != 0; }
  const std::optional<Refusal>& refusal() const { return refusal_; }
  // False for a swap that timed out while the Spine had it: the law may still be committed.
  bool outcome_is_known() const;
  std::int64_t stage_since_ns() const { return stage_since_ns_; }

  // submitted, refused, not_confirmed, measured, committed, unproven, confirmed or rolled_back: the last three are
  // about the law after its commit.
  const char* verdict() const;
  // The certificate: request, times and findings of every stage. Times are CLOCK_MONOTONIC [ns].
  Json certificate() const;

 private:
  bool enter(Stage stage, const std::string& reason, std::int64_t now_ns);
  void reopen();
  std::int64_t time_of(Stage stage) const;  // 0 = not reached
  double ms_between(Stage from, Stage to) const;
  Json split_ms() const;
  Json times_ns() const;

  std::uint64_t request_id_;
  SwapRequest request_;
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

// Summary of a certificate for `lithe status`: law, verdict, and the reason of a bad verdict.
Json summary_of(const Json& certificate);

}  // namespace lithe::control
