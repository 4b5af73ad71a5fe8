// SPDX-License-Identifier: Apache-2.0
// The system calls behind a change: what is there now, and how it is set.
#pragma once

#include <functional>
#include <string>

#include "host/tune/change.hpp"

namespace lithe::host {

// Called before every system call that changes the machine or a journal: a test ends the process there.
using StepHook = std::function<void()>;

// The present value of what a change is about.
struct Now {
  bool absent = false;  // no such file, folder or task (any more)
  std::string value{};
  int error = 0;  // errno when it cannot be read; then the rest says nothing

  bool operator==(const Now& other) const {
    return error == 0 && other.error == 0 && absent == other.absent && (absent || value == other.value);
  }
};

Now before(const Change& change);
Now after(const Change& change);

// Below `root`; tasks are always those of this machine.
class Writer {
 public:
  explicit Writer(std::string root, StepHook hook = {}) : root_(std::move(root)), hook_(std::move(hook)) {}

  const std::string& root() const { return root_; }

  Now now(const Change& change) const;

  // Sets it; returns 0, or the errno of the call that failed. A file is replaced at once and reaches the disk before
  // this returns; its mode and owner stay. A file that is a symbolic link is refused (ELOOP).
  int set(const Change& change, const Now& wanted) const;

  // Removes what a killed set() may have left beside a file.
  void clean(const Change& change) const;

  // For the journal, which writes as carefully: the hook, then the call.
  void step() const {
    if (hook_) hook_();
  }

 private:
  bool is_inside(const std::string& path) const;
  int set_file(const std::string& path, const Now& wanted) const;
  int set_value(const std::string& path, const std::string& value) const;
  int set_folder(const std::string& path, const Now& wanted) const;
  int set_group(const std::string& path, const Now& wanted) const;
  int set_cores(const Change& change, const std::string& cores) const;

  std::string root_;
  StepHook hook_;
};

// Makes the names in the folder of `path` reach the disk.
void sync_folder_of(const std::string& path);

}  // namespace lithe::host
