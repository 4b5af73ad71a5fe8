// SPDX-License-Identifier: Apache-2.0
// The swap queue: one swap at a time; the head is driven to its verdict.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <string>

#include "supervisor/swap/transaction.hpp"

namespace lithe::swap {

// The queue's outputs. Each starts work and returns at once; the answer comes back as an event.
struct Ports {
  std::function<void(const Transaction&)> compile;
  std::function<void(const Transaction&)> place;
  std::function<void(const Transaction&)> attempt;  // the trial
  std::function<void(const Transaction&)> stage;
  std::function<std::uint64_t()> missed_releases;
  std::function<void(Transaction&&)> finished;  // called once per transaction, committed or refused
};

struct Timeouts {
  std::int64_t compile_ns = 60'000'000'000;
  std::int64_t place_ns = 60'000'000'000;
  std::int64_t trial_ns = 60'000'000'000;
  std::int64_t stage_ns = 10'000'000'000;
  std::int64_t commit_ns = 5'000'000'000;  // plus the time in the shadow
};

// Contract: one thread · the clock is an argument · events about any request but the head are ignored.
class Queue {
 public:
  static constexpr std::size_t kMaxWaiting = 64;

  Queue(Ports ports, std::uint64_t first_request_id, Timeouts timeouts = {});

  // Returns the request id, or 0 when kMaxWaiting requests wait already.
  std::uint64_t submit(Request request, std::int64_t now_ns);

  // The compile service has compiled and admitted the law.
  void on_compiled(std::uint64_t request_id, Compiled compiled, const std::string& admitted, std::int64_t now_ns);
  void on_placed(std::uint64_t request_id, const std::string& where, std::int64_t now_ns);
  void on_tried(std::uint64_t request_id, const std::string& how, std::int64_t now_ns);
  void on_staged(std::uint64_t request_id, std::int64_t now_ns);
  void on_shadow(std::uint64_t request_id, std::int64_t now_ns);
  void on_committed(std::uint64_t request_id, std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns);
  void on_refused(std::uint64_t request_id, Refusal reason, std::int64_t now_ns);
  // Sets a section in the head's certificate.
  void note(std::uint64_t request_id, const std::string& section, Json what);

  // Ends a step that has timed out; starts the next request when the head is finished.
  void step(std::int64_t now_ns);
  // Ends all requests (the robot stops, or the Spine has ended).
  void refuse_all(const Refusal& reason, std::int64_t now_ns);

  bool idle() const { return waiting_.empty(); }
  std::size_t size() const { return waiting_.size(); }
  const Transaction* newest() const { return waiting_.empty() ? nullptr : &waiting_.back(); }
  const Transaction* head() const { return waiting_.empty() ? nullptr : &waiting_.front(); }

 private:
  Transaction* current(std::uint64_t request_id);
  std::int64_t limit_ns(const Transaction& swap) const;
  void supersede(const Request& newer, std::int64_t now_ns);
  void give_up(Refusal reason, std::int64_t now_ns);
  void settle();

  Ports ports_;
  Timeouts timeouts_;
  std::uint64_t next_id_;
  std::deque<Transaction> waiting_;
  bool running_ = false;
};

}  // namespace lithe::swap
