// SPDX-License-Identifier: Apache-2.0
// The journal of changes. An entry is on disk before its change is made, so that the next process can undo what a
// killed one did.
#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include "host/tune/change.hpp"
#include "host/tune/journal/writer.hpp"
#include "spine/core/host/fd.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

// One change that is not undone yet. Several changes of one path are one entry: the first value before, every value
// after. Of a file that somebody edited between two changes: the text before the second.
struct Entry {
  std::uint64_t number = 0;
  Change change{};                  // `before` and `was_absent`: of the first, or since that edit
  std::vector<std::string> ours{};  // values that we wrote
  std::int64_t at_ticks = 0;        // clock ticks since boot, as start_time_ticks counts
};

inline constexpr const char* kUndone = "undone";

// A file of JSON lines. Three kinds, in the order in which they are written:
//   {"number": 1, "boot": ID, "at_ticks": T, "change": {...}}   before the change; on disk before it begins
//   {"number": 1, "done": true, "after": VALUE}                 after it; or "done": false and "error"
//   {"number": 1, "dropped": WHY}                               it is undone, or no longer ours
// A last line without its end is ignored: its change had not begun.
// Contract: one process at a time, by flock(2), for as long as the object lives · one thread
class Journal {
 public:
  // `boot`: the entries are of this boot only, those of another are void; "": they are of files that survive it.
  // `make`: makes the file and its folder where there are none; else an absent journal is an empty one. Errors: no
  // permission, or another process holds it.
  static Result<Journal> open(const std::string& path, const std::string& boot, bool make, StepHook hook = {});

  Result<std::uint64_t> begin(const Change& change);
  Result<> finish(std::uint64_t number, int error, const std::string& after);
  Result<> drop(std::uint64_t number, const std::string& why);

  // In the order of their first change.
  const std::vector<Entry>& entries() const { return entries_; }
  // The items of what was undone and not made again since the file was made, also by a process that was killed then.
  const std::set<std::string>& undone() const { return undone_; }
  std::size_t unreadable_lines() const { return unreadable_; }
  const std::string& path() const { return path_; }

  // Removes the file; only without entries, and without lines that cannot be read if those are not given up.
  void remove(bool unreadable_too = false);

 private:
  Journal(std::string path, std::string boot, StepHook hook)
      : path_(std::move(path)), boot_(std::move(boot)), steps_("", std::move(hook)) {}

  Result<> lock(bool make);
  Result<> load();
  void take(const std::string& line);
  void merge(Entry entry);
  Result<> append(const std::string& line, bool to_disk);

  std::string path_, boot_;
  Writer steps_;
  Fd file_;
  std::vector<Entry> entries_;
  std::set<std::string> undone_;
  std::uint64_t last_ = 0;
  std::size_t unreadable_ = 0;
};

// This boot's id; "" when it cannot be read.
std::string boot_id(const std::string& root = "");

// Every byte as one character, so that text of any encoding fits into JSON and comes back as it was.
std::string bytes_as_text(const std::string& bytes);
std::string text_as_bytes(const std::string& text);

// Makes changes and undoes them. Every step stands in the journal first.

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
