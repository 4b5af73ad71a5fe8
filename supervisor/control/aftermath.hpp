// SPDX-License-Identifier: Apache-2.0
// What becomes of a law after its commit: confirmed, rolled back, retired. Its certificate is kept up to date.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "supervisor/control/spine_link.hpp"
#include "supervisor/swap/transaction.hpp"

namespace lithe::control {

// Contract: one thread · never blocks · knows only laws whose commit it was told, not those of an earlier supervisor
class Aftermath {
 public:
  // Called when a certificate has changed.
  using Keep = std::function<void(const swap::Transaction&, const std::filesystem::path&)>;

  Aftermath(const SpineLink& spine, Keep keep);

  // `record`: its certificate's file; empty = there is none.
  void follow(swap::Transaction swap, std::filesystem::path record);
  void on_event(const wire::Event& event);
  // The robot stops, or its Spine is gone: no law comes to a better end.
  void end(const std::string& why, std::int64_t now_ns);

 private:
  struct Life {
    swap::Transaction swap;
    std::filesystem::path record;
    std::string fault;  // why it is about to be replaced; empty = nothing is wrong
  };

  Life* of_request(std::uint64_t request_id);
  Life* of_law(std::uint32_t law_id);
  void faulted(const wire::Event& event);
  void rolled_back(const wire::Event& event);
  void leave(Life& life, const std::string& why, const wire::Event& event);

  Keep keep_;
  ipc::RingReader<wire::LawFault, wire::spine_segment::kLawFaultsDepth> faults_;
  std::deque<Life> lives_;              // oldest commit first
  std::vector<std::uint32_t> running_;  // law ids in the order of their commits; a rollback takes off the end
};

}  // namespace lithe::control
