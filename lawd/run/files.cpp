// SPDX-License-Identifier: Apache-2.0
#include "lawd/run/files.hpp"

#include <fcntl.h>
#include <sys/file.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <map>
#include <utility>
#include <vector>

#include "spine/core/host/files.hpp"

namespace lithe::lawd {

namespace fs = std::filesystem;

std::optional<std::string> read_file(const std::string& path) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 30;
  Result<std::string> bytes = read_regular_file(path, kMostBytes);
  return bytes ? std::optional(std::move(*bytes)) : std::nullopt;
}

void keep_newest(const std::string& folder, std::uintmax_t most_bytes) {
  struct Group {
    fs::file_time_type newest = fs::file_time_type::min();
    std::uintmax_t bytes = 0;
    std::vector<fs::path> files;
  };
  std::map<std::string, Group> by_name;
  std::uintmax_t all_bytes = 0;
  std::error_code error;
  for (const fs::path& path : files_in(folder)) {
    std::error_code gone;
    if (!fs::is_regular_file(path, gone)) continue;
    const std::uintmax_t bytes = fs::file_size(path, gone);
    const fs::file_time_type written = fs::last_write_time(path, gone);
    if (gone) continue;
    Group& group = by_name[path.stem().string()];
    group.newest = std::max(group.newest, written);
    group.bytes += bytes;
    group.files.push_back(path);
    all_bytes += bytes;
  }
  std::vector<const Group*> oldest_first;
  for (const auto& [name, group] : by_name) oldest_first.push_back(&group);
  std::ranges::sort(oldest_first, {}, &Group::newest);
  for (const Group* group : oldest_first) {
    if (all_bytes <= most_bytes) return;
    for (const fs::path& file : group->files) fs::remove(file, error);
    all_bytes -= group->bytes;
  }
}

namespace {

constexpr const char* kScratch = "scratch.";

// Empty when another process holds it.
Fd lock_folder(const std::string& path) {
  Fd folder(open(path.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  return folder && flock(folder.get(), LOCK_EX | LOCK_NB) == 0 ? std::move(folder) : Fd();
}

}  // namespace

void sweep_scratch(const std::string& parent) {
  for (const fs::path& path : files_in(parent)) {
    std::error_code ignored;
    if (path.filename().string().starts_with(kScratch) && lock_folder(path)) fs::remove_all(path, ignored);
  }
}

ScratchDir::ScratchDir(const std::string& parent) {
  std::error_code failed;
  std::filesystem::create_directories(parent, failed);
  std::string name = parent + "/" + kScratch + "XXXXXX";
  if (mkdtemp(name.data()) == nullptr) {
    error_ = std::strerror(errno);
    return;
  }
  path_ = name;
  lock_ = lock_folder(path_);
  setenv("TMPDIR", path_.c_str(), 1);
}

ScratchDir::~ScratchDir() {
  std::error_code ignored;
  if (!path_.empty()) std::filesystem::remove_all(path_, ignored);
}

}  // namespace lithe::lawd
