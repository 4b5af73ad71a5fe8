// SPDX-License-Identifier: Apache-2.0
// Keeps other tasks off a robot's cores while one process lives. Its end undoes this; after a kill, the next shield
// does.
#pragma once

#include <cstddef>
#include <cstdint>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "host/tune/journal/journal.hpp"
#include "host/tune/shield/shield_plan.hpp"

namespace lithe::host {

// Its holder locks this file for as long as the shield is up; the lock ends with the process, however that ends.
inline constexpr const char* kShieldJournal = "/run/lithe/shield.journal";

struct ShieldOptions {
  std::vector<int> cores{};  // the robot's, ascending
  std::vector<int> leave{};  // processes that keep the cores; their children inherit
  std::vector<int> only{};   // these processes alone, instead of every one; for tests
  bool machine = true;       // also the settings of runtime_plan() and the groups of shield_plan()
  bool partition = true;     // also a partition of cgroup v2, where `machine` and the kernel allow one
  std::string root{};        // of the files that `machine` means; for tests
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
  std::size_t unreadable = 0;         // lines of the journal: what they say was not given back
  std::vector<std::string>
      born{};  // tasks started while the shield was up; they may use its cores again: "cc1plus 4711"
};

// "tasks started while the shield was up have all cores again: cc1plus 4711, make 4700 and 3 more; ..."; empty when
// there are none. A task that chose exactly the shield's cores itself looks like one that inherited them, so they are
// named.
std::string born_words(const Lowered& lowered);

// Contract: one thread. The destructor lowers the shield; a kill leaves the journal.
class Shield {
 public:
  // Undoes what a killed holder left, then raises a new one. Errors: another process holds a shield; no permission
  // (then nothing stays changed).
  static Result<Shield> raise(const ShieldOptions& options);

  // Undoes what a killed holder left, whatever its cores were. An error when a living process holds it.
  // `forget`: lines of its journal that cannot be read are given up.
  static Result<Lowered> lower_left_over(const ShieldOptions& left = {}, bool forget = false);

  Shield(Shield&& other) noexcept
      : journal_(std::move(other.journal_)),
        writer_(std::move(other.writer_)),
        options_(std::move(other.options_)),
        facts_(std::move(other.facts_)),
        tried_(std::move(other.tried_)),
        moves_(other.moves_),
        partition_(other.partition_),
        up_(std::exchange(other.up_, false)) {}
  Shield& operator=(Shield&&) = delete;
  ~Shield();

  const ShieldFacts& facts() const { return facts_; }
  bool has_partition() const { return partition_; }  // made by this shield: its cores are for the members of its group

  // To be called every few seconds. Moves kernel threads that started since: the kernel gives them all cores. Returns
  // a sentence when the kernel ended the partition, and moves all tasks instead; else an empty text.
  Result<std::string> keep_up();

  // Gives everything back, also to tasks that started meanwhile and inherited the narrow mask; not to LITHE's own
  // programs, which choose their cores. What somebody else changed stays. The error names what could not be undone.
  Result<Lowered> lower();

 private:
  Shield(Journal journal, ShieldOptions options)
      : journal_(std::move(journal)), writer_(options.root, options.hook), options_(std::move(options)) {}

  Result<> make_partition(const ShieldPlan& plan);
  Result<> move_tasks(bool kernel = false);
  Result<> change_settings();
  Result<> take_out_of_balancing(const ShieldPlan& plan);

  Journal journal_;
  Writer writer_;
  ShieldOptions options_;
  ShieldFacts facts_;
  std::set<std::pair<std::string, std::uint64_t>> tried_;  // tasks: path, start time
  bool moves_ = false;                                     // tasks are kept away by us, not by a boot option
  bool partition_ = false;                                 // of our own
  bool up_ = true;
};

// "core 1, cpuset1: 59 tasks moved, 3 refused, 24 settings"
std::string shield_words(const ShieldFacts& facts);

}  // namespace lithe::host
