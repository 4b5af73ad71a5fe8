// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/files.hpp"

#include <fcntl.h>
#include <pwd.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>

namespace lithe {
namespace {

constexpr mode_t kHiddenFromOthers = 0027;
constexpr std::size_t kChunkBytes = 65536;

Error wrong(const std::string& path, const std::string& why) { return Error{path + ": " + why}; }

Error too_large(const std::string& path, std::size_t most_bytes) {
  return wrong(path, "is larger than " + std::to_string(most_bytes) + " bytes");
}

constexpr const char* kNoFile = "is a device, a pipe or a socket, not a file";

}  // namespace

Result<Fd> open_regular(int folder, const std::string& path, int flags) {
  Fd file(openat(folder, path.c_str(), flags | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY | O_CLOEXEC, 0640));
  struct stat about{};
  if (!file && errno == ENXIO) return wrong(path, kNoFile);
  if (!file && errno == ELOOP) return wrong(path, "is a symbolic link, not a file");
  if (!file || fstat(file.get(), &about) != 0) return wrong(path, reason_of(errno));
  if (!S_ISREG(about.st_mode)) return wrong(path, S_ISDIR(about.st_mode) ? "is a directory, not a file" : kNoFile);
  return file;
}

std::string user_name(uid_t user) {
  const passwd* entry = getpwuid(user);
  return entry != nullptr ? entry->pw_name : "uid " + std::to_string(user);
}

Result<Fd> open_own_folder(const std::string& path, const std::string& variable) {
  Fd folder(open(path.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  const int failed = errno;
  struct stat about{};
  const bool there = (folder ? fstat(folder.get(), &about) : lstat(path.c_str(), &about)) == 0;
  const bool ours = about.st_uid == geteuid() || about.st_uid == 0;
  if (!there || (S_ISDIR(about.st_mode) && ours && (about.st_mode & S_IWOTH) == 0)) {
    errno = failed;
    return folder;
  }
  char mode[8];
  std::snprintf(mode, sizeof mode, "%04o", about.st_mode & 07777U);
  const std::string kind = S_ISLNK(about.st_mode)   ? "a symbolic link"
                           : S_ISDIR(about.st_mode) ? "a folder"
                                                    : "no folder";
  const std::string mend = ours && S_ISDIR(about.st_mode) ? "close it (chmod o-w " + path + ")" : "remove it";
  return wrong(path, "is not used: it is " + kind + " of " + user_name(about.st_uid) + " (mode " + mode +
                         "), and others could put files there; " + mend + ", or set " + variable +
                         " to a folder of your own");
}

Result<std::string> read_regular_file(const std::string& path, std::size_t most_bytes) {
  const Fd file(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY));
  if (!file) return wrong(path, reason_of(errno));
  struct stat about{};
  if (fstat(file.get(), &about) != 0) return wrong(path, std::strerror(errno));
  if (S_ISDIR(about.st_mode)) return wrong(path, "is a directory, not a file");
  if (!S_ISREG(about.st_mode)) return wrong(path, kNoFile);
  if (about.st_size > static_cast<off_t>(most_bytes)) return too_large(path, most_bytes);
  // Files of /proc report 0 bytes and may be endless, so the reported size is not used.
  std::string bytes;
  for (;;) {
    const std::size_t had = bytes.size();
    bytes.resize(had + std::min(kChunkBytes, most_bytes + 1 - had));
    ssize_t got = -1;
    do got = read(file.get(), bytes.data() + had, bytes.size() - had);
    while (got < 0 && errno == EINTR);
    if (got < 0) return wrong(path, std::strerror(errno));
    bytes.resize(had + static_cast<std::size_t>(got));
    if (bytes.size() > most_bytes) return too_large(path, most_bytes);
    if (got == 0) return bytes;
  }
}

std::vector<std::filesystem::path> files_in(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> found;
  std::error_code failed;
  for (std::filesystem::directory_iterator at(folder, failed), end; !failed && at != end; at.increment(failed))
    found.push_back(at->path());
  std::ranges::sort(found);
  return found;
}

std::string reason_of(int error) {
  const std::string limit = error == EFBIG ? "-f" : error == EMFILE ? "-n" : "";
  return std::strerror(error) + (limit.empty() ? "" : ": over a limit (ulimit " + limit + ")");
}

int write_all(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t put = write(fd, bytes.data(), bytes.size());
    if (put < 0 && errno != EINTR) return errno;
    if (put > 0) bytes.remove_prefix(static_cast<std::size_t>(put));
  }
  return 0;
}

std::string write_file_whole(const std::string& path, std::string_view bytes) {
  const std::string part = path + ".part" + std::to_string(getpid());
  unlink(
      part.c_str());  // left by a process that died while it wrote, and had our pid; or a link that somebody put there
  const Fd file(open(part.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0640));
  if (!file) return reason_of(errno);
  struct stat old{};
  if (stat(path.c_str(), &old) == 0) fchmod(file.get(), old.st_mode & 07777U);
  int failed = write_all(file.get(), bytes);
  if (failed == 0 && rename(part.c_str(), path.c_str()) != 0) failed = errno;
  if (failed == 0) return "";
  unlink(part.c_str());
  return reason_of(failed);
}

void set_file_defaults() {
  umask(umask(kHiddenFromOthers) | kHiddenFromOthers);
  signal(SIGXFSZ, SIG_IGN);
}

}  // namespace lithe
