// SPDX-License-Identifier: Apache-2.0
// A robot's cores, kept free for the life of one process, and given back at its end or by the next one.
#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "host/tune/journal/apply.hpp"
#include "host/tune/shield/shield_plan.hpp"

namespace lithe::host {

// Its holder locks this file for as long as the shield is up; the lock ends with the process, however that ends.
inline constexpr const char* kShieldJournal = "/run/lithe/shield.journal";

struct ShieldOptions {
  std::vector<int> cores{};  // the robot's, ascending
  std::vector<int> leave{};  // processes that keep the cores; their children inherit
  std::vector<int> only{};   // these processes alone, instead of every one; for tests
  bool machine = true;       // also the settings of runtime_plan() and the groups of shield_plan(); not in tests
  std::string journal = kShieldJournal;
  StepHook hook{};
};

// What a raised shield is: for status and for people.
struct ShieldFacts {
  Mechanism mechanism = Mechanism::affinity;
  std::vector<int> cores{};
  std::size_t moved = 0;             // tasks
  std::size_t refused = 0;           // tasks that the kernel did not let move
  std::size_t settings = 0;          // settings of the kernel that were changed
  std::vector<std::string> notes{};  // what could not be done, and why
};

struct Lowered {
  std::size_t count = 0;              // tasks and settings that were given back
  std::vector<std::string> failed{};  // what could not be, and why
};

// Contract: one thread. The destructor lowers the shield; a kill leaves the journal.
class Shield {
 public:
  // Undoes what a killed holder left, then raises a new one. Errors: another process holds a shield; no permission (then
  // nothing stays changed).
  static Result<Shield> raise(const ShieldOptions& options);

  // Undoes what a killed holder left. An error when a living process holds it.
  static Result<Lowered> lower_left_over(const std::string& journal = kShieldJournal,
                                         const std::vector<int>& only = {});

  Shield(Shield&& other) noexcept
      : journal_(std::move(other.journal_)),
        writer_(std::move(other.writer_)),
        options_(std::move(other.options_)),
        facts_(std::move(other.facts_)),
        up_(std::exchange(other.up_, false)) {}
  Shield& operator=(Shield&&) = delete;
  ~Shield();

  const ShieldFacts& facts() const { return facts_; }

  // Gives everything back, also to tasks that were born meanwhile and inherited the narrow mask (one that chose just this
  // mask itself cannot be told from them). What somebody else changed stays. The error names what could not be undone.
  Result<> lower();

 private:
  Shield(Journal journal, ShieldOptions options)
      : journal_(std::move(journal)), writer_("", options.hook), options_(std::move(options)) {}

  Result<> move_tasks();
  Result<> change_settings();
  Result<> take_out_of_balancing(const ShieldPlan& plan);

  Journal journal_;
  Writer writer_;
  ShieldOptions options_;
  ShieldFacts facts_;
  bool up_ = true;
};

// "core 1, cpuset1: 59 tasks moved, 3 refused, 24 settings"
std::string shield_words(const ShieldFacts& facts);

}  // namespace lithe::host
