// SPDX-License-Identifier: Apache-2.0
// Small files, read whole and written whole or not at all.
#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace lithe::lawd {

// The bytes of a file; nothing when it cannot be read.
std::optional<std::string> read_file(const std::string& path);

// Writes under another name, flushes to the disk, renames. Returns "" or what went wrong ("No space left on device").
std::string write_file_whole(const std::string& path, std::string_view bytes);

// A directory that is gone with this object.
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
