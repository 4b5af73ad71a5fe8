// SPDX-License-Identifier: Apache-2.0
// Makes changes and undoes them. Every step stands in the journal first.
#pragma once

#include <string>
#include <vector>

#include "host/tune/journal/journal.hpp"
#include "host/tune/journal/writer.hpp"

namespace lithe::host {

enum class Outcome : std::uint8_t {
  done,     // changed, or undone
  already,  // it had the value
  gone,     // the task, or the file of the kernel, is there no longer: nothing is left to undo
  fixed,    // an interrupt that the kernel or its driver keeps where it is (a timer, one of a queue for each core)
  refused,  // the kernel or the file system did not take it; `error`
  foreign,  // somebody else changed it meanwhile: left as it is, and kept in the journal
};

struct Step {
  Change change{};
  Outcome outcome = Outcome::done;
  int error = 0;        // errno, with refused
  std::string found{};  // the value that was found, with foreign

  // In order, or nothing to do.
  bool well() const { return outcome <= Outcome::fixed; }
  // Why not: "Permission denied", "somebody else set it to 3".
  std::string why() const;
};

// How a write ended that gave this errno (0: none).
Outcome outcome_of(const Change& change, int error);

// One step for each change, in order. A change whose `before` is not there any more is `foreign`. The error is the
// journal's: then nothing more was changed.
Result<std::vector<Step>> apply(Journal& journal, const Writer& writer, const std::vector<Change>& changes);

// Undoes the journal, last change first, and removes it when nothing is left in it. `forget`: what somebody else
// changed is dropped from the journal, and left as it is.
Result<std::vector<Step>> revert(Journal& journal, const Writer& writer, bool forget = false);

// Undoes these entries alone, last first; keeps the journal.
Result<std::vector<Step>> revert_entries(Journal& journal, const Writer& writer, std::vector<Entry> entries,
                                         bool forget);

}  // namespace lithe::host
