// SPDX-License-Identifier: Apache-2.0
// What becomes of a law after its commit: confirmed, rolled back, retired. Its certificate is kept up to date.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/link/spine_link.hpp"
#include "supervisor/swap/witness.hpp"
#include "supervisor/swap/record.hpp"
#include "supervisor/swap/transaction.hpp"

namespace lithe::control {

// Contract: one thread · never blocks · knows only laws whose commit it was told, not those of an earlier supervisor
class Aftermath {
 public:
  // Called when a certificate has changed.
  using Keep = std::function<void(const swap::Transaction&, const swap::RecordBook::Page&)>;
  // Finds the line of a law that failed, so many bytes from the start of its slot: {"where", "function"}, null when
  // nobody knows. It may answer at any time.
  using Found = std::function<void(const swap::Json& place)>;
  using Locate = std::function<void(const swap::Transaction& swap, std::uint32_t offset, Found found)>;
  static constexpr std::size_t kFaultsKept = 8;
  static constexpr std::int64_t kMeasureAfterNs = 60'000'000;  // a little more than the window

  Aftermath(const SpineLink& spine, Keep keep, Locate locate = {});

  // `before`: counted when the Loader was asked.
  void follow(swap::Transaction swap, swap::RecordBook::Page record, const CoreCounts& before, std::int64_t now_ns);
  // Measures what is due.
  void serve(std::int64_t now_ns);
  // Measures all that was not: what comes now is not theirs.
  void measure_all();
  void on_event(const wire::Event& event);
  // A section of the certificate of a law that still lives.
  void note(std::uint64_t request_id, const std::string& section, swap::Json what);
  // The last faults of laws, oldest first, as their certificates tell them.
  const swap::Json& faults() const { return told_; }
  // The robot stops, or its Spine is gone: no law comes to a better end.
  void end(const std::string& why, std::int64_t now_ns);

 private:
  struct Life {
    swap::Transaction swap;
    swap::RecordBook::Page record;
    CoreCounts before;
    std::int64_t measure_at_ns;  // 0 = it was done
    std::string fault;           // why it is about to be replaced; empty = nothing is wrong
    bool asked = false;          // where it failed: the answer is still to come
    bool retired = false;        // it only waits for that answer
  };

  void measure(Life& life);
  Life* of_request(std::uint64_t request_id);
  Life* of_law(std::uint32_t law_id);
  std::optional<wire::LawFault> record_of(const wire::Event& event);
  void faulted(const wire::Event& event);
  void tell_fault(Life& life, swap::Json fault);
  void locate(Life& life, const wire::LawFault& fault);
  void retired(const wire::Event& event);
  void rolled_back(const wire::Event& event);
  void leave(Life& life, const std::string& why, const wire::Event& event);

  const SpineLink& spine_;
  Keep keep_;
  Locate locate_;
  swap::Json told_ = swap::Json::array();
  ipc::RingReader<wire::LawFault, wire::spine_segment::kLawFaultsDepth> faults_;
  std::deque<wire::LawFault> untold_;   // read from the ring, their events not seen yet
  std::deque<Life> lives_;              // oldest commit first
  std::vector<std::uint32_t> running_;  // law ids in the order of their commits; a rollback takes off the end
};

}  // namespace lithe::control
