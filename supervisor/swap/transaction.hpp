// SPDX-License-Identifier: Apache-2.0
// One swap, from the request to its verdict. Pure bookkeeping: no clock, no file, no process.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "supervisor/swap/answer.hpp"
#include "supervisor/swap/terms.hpp"

namespace lithe::swap {

// submitted -> compiled -> staged -> committed, or refused from anywhere before committed.
enum class Stage { submitted, compiled, staged, committed, refused };

const char* to_string(Stage stage);

// What a client asked for.
struct Request {
  std::string name;              // file name shown in diagnostics
  std::string source;            // C++ text of one law
  Json params = Json::object();  // name -> value, set right after the commit
  Terms terms = {};
};

// What the compile service made of it.
struct Compiled {
  std::string object;  // path of the shared object
  std::string hash;    // SHA-256 of source, contract and flags
  std::string law;     // the name the law gave itself
  bool cached = false;
  double compile_ms = 0.0;
  Json descriptor = Json::object();  // params, state fields and probes of the law
};

// Contract: one thread · every transition checks the order and returns false, changing nothing, when it is not legal ·
// times are read by several processes; one that lies before its predecessor counts as equal to it.
class Transaction {
 public:
  Transaction(std::uint64_t request_id, Request request, std::int64_t now_ns);

  bool mark_started(std::int64_t now_ns);
  bool mark_compiled(Compiled compiled, std::int64_t now_ns);
  bool mark_staged(std::int64_t now_ns);
  bool mark_committed(std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns);
  bool mark_refused(Refusal reason, std::int64_t now_ns);

  // Releases the Spine had missed when the swap began and when it ended: what the swap may have cost.
  void note_missed_before(std::uint64_t missed) { missed_before_ = missed; }
  void note_missed_after(std::uint64_t missed) { missed_after_ = missed; }

  std::uint64_t request_id() const { return request_id_; }
  const Request& request() const { return request_; }
  const Compiled& compiled() const { return compiled_; }
  std::uint32_t law_id() const { return law_id_; }  // 0 before the commit
  Stage stage() const { return stage_; }
  bool finished() const { return stage_ == Stage::committed || stage_ == Stage::refused; }
  const std::optional<Refusal>& refusal() const { return refusal_; }
  // False for a swap that ran out of time with the Spine: the law may still be committed.
  bool confirmed() const;
  std::int64_t stage_since_ns() const { return stage_since_ns_; }

  // The first-form certificate: who, what, when, verdict. Times are CLOCK_MONOTONIC nanoseconds.
  Json certificate() const;

 private:
  void enter(Stage stage, std::int64_t now_ns);

  std::uint64_t request_id_;
  Request request_;
  Compiled compiled_;
  Stage stage_ = Stage::submitted;
  Stage refused_in_ = Stage::submitted;
  std::int64_t submitted_ns_;
  std::int64_t started_ns_ = 0;
  std::int64_t compiled_ns_ = 0;
  std::int64_t staged_ns_ = 0;
  std::int64_t finished_ns_ = 0;
  std::int64_t stage_since_ns_;
  std::uint64_t commit_tick_ = 0;
  std::uint32_t law_id_ = 0;
  std::uint64_t missed_before_ = 0;
  std::uint64_t missed_after_ = 0;
  std::optional<Refusal> refusal_;
};

}  // namespace lithe::swap
