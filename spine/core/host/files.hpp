// SPDX-License-Identifier: Apache-2.0
// Reads files with names from users, writes whole files; folders that only we may write; permissions of created files.
// Off the tick.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/host/fd.hpp"
#include "spine/core/result.hpp"

namespace lithe {

inline constexpr std::size_t kMaxLawBytes = std::size_t{1} << 20;     // of a law's source
inline constexpr std::size_t kMaxConfigBytes = std::size_t{1} << 20;  // of a robot file

// The bytes of a regular file, `most_bytes` at most. A directory, a device, a pipe and a larger file are errors:
// "<path>: is a directory, not a file". Never waits (a pipe without a writer) and never reads without end (/dev/zero).
Result<std::string> read_regular_file(const std::string& path, std::size_t most_bytes);

// A regular file, opened without waiting (a pipe without its other end) and without following a symbolic link.
// `folder`: where a relative path starts, or AT_FDCWD. `flags` as for openat(); a new file has mode 0640 at most.
Result<Fd> open_regular(int folder, const std::string& path, int flags);

// "alice", or "uid 1001" when the user has no name here.
std::string user_name(uid_t user);

// The folder, opened. Error when others could put files there, or replace it: it is no real directory, belongs neither
// to this user nor to root, or is open to everybody; `variable` (of the environment) can name another one. Members of
// its group are trusted. Empty, with errno, when it is absent or cannot be opened.
Result<Fd> open_own_folder(const std::string& path, const std::string& variable);

// The paths in a folder, sorted; empty when there is none, or it cannot be read.
std::vector<std::filesystem::path> files_in(const std::filesystem::path& folder);

// strerror(), and the limit that was met: "File too large: over a limit (ulimit -f)".
std::string reason_of(int error);

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
