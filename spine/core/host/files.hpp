// SPDX-License-Identifier: Apache-2.0
// Reads files with names from users, writes whole files; sets permissions of created files. Off the tick.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/result.hpp"

namespace lithe {

inline constexpr std::size_t kMaxLawBytes = std::size_t{1} << 20;     // of a law's source
inline constexpr std::size_t kMaxConfigBytes = std::size_t{1} << 20;  // of a robot file

// The bytes of a regular file, `most_bytes` at most. A directory, a device, a pipe and a larger file are errors:
// "<path>: is a directory, not a file". Never waits (a pipe without a writer) and never reads without end (/dev/zero).
Result<std::string> read_regular_file(const std::string& path, std::size_t most_bytes);

// The paths in a folder, sorted; empty when there is none, or it cannot be read.
std::vector<std::filesystem::path> files_in(const std::filesystem::path& folder);

// Writes all bytes; 0 or errno.
int write_all(int fd, std::string_view bytes);

// Writes to PATH.partPID, then renames: a reader sees the whole file or none. A file that was there keeps its mode.
// Returns "" or the error ("No space left on device"). Not flushed to disk: the disk's interrupts may come to the
// Spine's core.
std::string write_file_whole(const std::string& path, std::string_view bytes);

// For the start of main(), and inherited by children. Files are made 0640 and directories 0750 at most: certificates,
// caches and logs hold source text (a stricter umask stays; sockets and segments set their own mode). A write beyond
// the limit of a file's size (ulimit -f) is an error like a full disk, not a signal that ends the process.
void set_file_defaults();

}  // namespace lithe
