// SPDX-License-Identifier: Apache-2.0
// Small files: reads them, keeps a folder of them small; a temporary folder.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "spine/core/host/fd.hpp"

namespace lithe::lawd {

// The bytes of a file; empty when it cannot be read.
std::optional<std::string> read_file(const std::string& path);

// Removes the files that were written longest ago until the folder holds at most `most_bytes`. Files that differ in
// their ending only go together. What cannot be read or removed stays.
void keep_newest(const std::string& folder, std::uintmax_t most_bytes);

// Removes the temporary directories in a folder whose processes were killed.
void sweep_scratch(const std::string& parent);

// A temporary directory, removed with this object, and locked until then. The compiler's own files go there, too
// (TMPDIR): one that is killed leaves nothing elsewhere.
class ScratchDir {
 public:
  explicit ScratchDir(const std::string& parent);
  ~ScratchDir();
  ScratchDir(const ScratchDir&) = delete;
  ScratchDir& operator=(const ScratchDir&) = delete;
  const std::string& path() const { return path_; }    // empty when it could not be made
  const std::string& error() const { return error_; }  // why

 private:
  std::string path_;
  std::string error_;
  Fd lock_;
};

}  // namespace lithe::lawd
