// SPDX-License-Identifier: Apache-2.0
#include "lawd/run/files.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <vector>

namespace lithe::lawd {

namespace fs = std::filesystem;

std::optional<std::string> read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) return std::nullopt;
  std::ostringstream bytes;
  bytes << in.rdbuf();
  if (in.bad()) return std::nullopt;
  return bytes.str();
}

std::string write_file_whole(const std::string& path, std::string_view bytes) {
  const std::string part = path + ".part" + std::to_string(getpid());
  const int fd = open(part.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0640);
  if (fd < 0) return std::strerror(errno);
  int failed = 0;
  while (!bytes.empty() && failed == 0) {
    const ssize_t put = write(fd, bytes.data(), bytes.size());
    if (put < 0 && errno != EINTR) failed = errno;
    if (put > 0) bytes.remove_prefix(static_cast<std::size_t>(put));
  }
  close(fd);
  if (failed == 0 && rename(part.c_str(), path.c_str()) != 0) failed = errno;
  if (failed == 0) return "";
  unlink(part.c_str());
  return std::strerror(failed);
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
  for (fs::directory_iterator at(folder, error); !error && at != fs::directory_iterator(); at.increment(error)) {
    std::error_code gone;
    if (!at->is_regular_file(gone)) continue;
    const std::uintmax_t bytes = at->file_size(gone);
    const fs::file_time_type written = at->last_write_time(gone);
    if (gone) continue;
    Group& group = by_name[at->path().stem().string()];
    group.newest = std::max(group.newest, written);
    group.bytes += bytes;
    group.files.push_back(at->path());
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

ScratchDir::ScratchDir(const std::string& parent) {
  std::error_code failed;
  std::filesystem::create_directories(parent, failed);
  std::string name = parent + "/scratch.XXXXXX";
  if (mkdtemp(name.data()) == nullptr)
    error_ = std::strerror(errno);
  else
    path_ = name;
}

ScratchDir::~ScratchDir() {
  std::error_code ignored;
  if (!path_.empty()) std::filesystem::remove_all(path_, ignored);
}

}  // namespace lithe::lawd
