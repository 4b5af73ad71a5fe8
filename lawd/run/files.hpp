// SPDX-License-Identifier: Apache-2.0
// Reads and writes small files; a write is complete or has no effect.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace lithe::lawd {

// The bytes of a file; empty when it cannot be read.
std::optional<std::string> read_file(const std::string& path);

// Writes to a temporary name, renames. Returns "" or the error ("No space left on device"). Not flushed to disk: a file
// that a power cut spoils is found by its hash and made again, and a disk's interrupts may come to the Spine's core.
std::string write_file_whole(const std::string& path, std::string_view bytes);

// Removes the files that were written longest ago until the folder holds at most `most_bytes`. Files that differ in
// their ending only go together. What cannot be read or removed stays.
void keep_newest(const std::string& folder, std::uintmax_t most_bytes);

// A temporary directory, removed with this object.
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
};

}  // namespace lithe::lawd
