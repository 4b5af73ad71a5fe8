// SPDX-License-Identifier: Apache-2.0
// Files of the kernel and of the system, below a folder that a test or a mounted image can replace. Off the tick.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "spine/core/result.hpp"

namespace lithe::host {

// The text of one file, or why there is none. A file that cannot be read never counts as "in order".
struct Reading {
  std::string path;   // without the root: what a person would type
  std::string value;  // without the newline at its end; empty if unread
  int error = 0;      // errno of the attempt; 0: read

  bool known() const { return error == 0; }
  bool is_absent() const;  // there is no such file: this kernel does not have it
};

// Reads below `root`: "" for this machine. `image`: of a system that does not run. Its /proc and /sys, should they be
// mounted there, are those of this machine: they count as absent.
class HostFiles {
 public:
  explicit HostFiles(std::string root = "", bool image = false) : root_(std::move(root)), image_(image) {}

  const std::string& root() const { return root_; }
  bool image() const { return image_; }

  // A larger file is an error (EFBIG). `path` is absolute: "/sys/devices/system/cpu/isolated".
  Reading read(const std::string& path, std::size_t most_bytes = std::size_t{64} << 10) const;

  // Whether there is such a file, also one that cannot be read.
  bool has(const std::string& path) const { return !read(path).is_absent(); }

  // Whether there is such a folder. A feature that a kernel does not have has no folder.
  bool is_folder(const std::string& path) const;

  // Whether there is certainly nothing of that name: neither a file nor a folder, nor one that cannot be looked at.
  bool is_gone(const std::string& path) const;

  // Names in a folder, sorted; empty if there is none or it cannot be read.
  std::vector<std::string> list(const std::string& folder) const;

 private:
  std::string place(const std::string& path) const;

  std::string root_;
  bool image_ = false;
};

// The text of a file packed with gzip: /proc/config.gz. An error, which names the file, when it is absent, not packed,
// damaged, cut short, or larger than that once unpacked.
Result<std::string> read_packed(const HostFiles& files, const std::string& path, std::size_t most_bytes);

}  // namespace lithe::host
