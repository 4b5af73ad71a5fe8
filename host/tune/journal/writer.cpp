// SPDX-License-Identifier: Apache-2.0
#include "host/tune/journal/writer.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstddef>
#include <filesystem>

#include "host/read/files.hpp"
#include "host/read/tasks.hpp"
#include "host/read/words.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/fd.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr std::size_t kMostFileBytes = std::size_t{16} << 20;

// Beside the file, so that rename() replaces it at once.
std::string new_name(const std::string& path) { return path + ".lithe-new"; }

Now text_of_file(const std::string& path) {
  struct stat about{};
  if (::lstat(path.c_str(), &about) != 0) return {.absent = errno == ENOENT, .error = errno == ENOENT ? 0 : errno};
  if (S_ISLNK(about.st_mode)) return {.error = ELOOP};
  const Result<std::string> text = read_regular_file(path, kMostFileBytes);
  return text ? Now{.value = *text} : Now{.error = EIO};
}

Now cores_of_task(const Change& change) {
  const std::optional<Task> task = read_task(HostFiles(), change.path);
  const bool same = task && task->start_time_ticks == change.start_time_ticks;
  return same ? Now{.value = cpu_list(task->cpus)} : Now{.absent = true};
}

// Whether a group below has cores or memory of its own choice. Without the controller they would be lost; the kernel
// refuses only while a group hands it on to its children.
bool is_used(const std::string& root, const Change& change) {
  const HostFiles files(root);
  const std::string folder = change.path.substr(0, change.path.rfind('/'));
  const auto chose = [&](const std::string& group) {
    return std::ranges::any_of(
        std::array{"/cpuset.cpus", "/cpuset.cpus.exclusive", "/cpuset.mems"},
        [&](const char* file) { return !files.read(folder + "/" + group + file).value.empty(); });
  };
  return change.after == "cpuset" && std::ranges::any_of(files.list(folder), chose);
}

}  // namespace

Now before(const Change& change) { return {.absent = change.was_absent, .value = change.before}; }

Now after(const Change& change) { return {.value = change.after}; }

void sync_folder_of(const std::string& path) {
  const Fd folder(::open(path.substr(0, path.rfind('/')).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (folder) ::fsync(folder.get());
}

Now Writer::now(const Change& change) const {
  const std::string path = root_ + change.path;
  if (change.kind == ChangeKind::affinity) return cores_of_task(change);
  if (change.kind == ChangeKind::file) return text_of_file(path);
  if (change.kind == ChangeKind::folder || change.kind == ChangeKind::group) {
    struct stat about{};
    if (::lstat(path.c_str(), &about) == 0) return {};
    return {.absent = errno == ENOENT, .error = errno == ENOENT ? 0 : errno};
  }
  const Reading reading = HostFiles(root_).read(change.path);
  if (reading.is_absent()) return {.absent = true};
  if (change.kind == ChangeKind::controller && reading.known())
    return has_word(reading.value, change.after) ? Now{.value = change.after} : Now{.absent = true};
  return {.value = value_in_force(reading.value), .error = reading.error};
}

// The links of an image, and "..", must not lead out of it.
bool Writer::is_inside(const std::string& path) const {
  if (root_.empty()) return true;
  std::error_code no_root, no_folder;
  const std::string root = std::filesystem::canonical(root_, no_root).string();
  const auto folder = std::filesystem::weakly_canonical(std::filesystem::path(path).parent_path(), no_folder).string();
  return !no_root && !no_folder && (folder + "/").starts_with(root + "/");
}

int Writer::set(const Change& change, const Now& wanted) const {
  const std::string path = root_ + change.path;
  if (change.kind != ChangeKind::affinity && !is_inside(path)) return ELOOP;
  switch (change.kind) {
    case ChangeKind::file:
      return set_file(path, wanted);
    case ChangeKind::folder:
      return set_folder(path, wanted);
    case ChangeKind::affinity:
      return set_cores(change, wanted.value);
    case ChangeKind::group:
      return set_group(path, wanted);
    case ChangeKind::controller:
      if (wanted.absent && is_used(root_, change)) return EBUSY;
      return set_value(path, (wanted.absent ? "-" : "+") + change.after);
    case ChangeKind::setting:
      break;
  }
  return set_value(path, wanted.value);
}

int Writer::set_file(const std::string& path, const Now& wanted) const {
  struct stat old{};
  const bool exists = ::lstat(path.c_str(), &old) == 0;
  if (exists && S_ISLNK(old.st_mode)) return ELOOP;
  if (wanted.absent) {
    step();
    if (exists && ::unlink(path.c_str()) != 0) return errno;
    sync_folder_of(path);
    return 0;
  }
  const std::string fresh = new_name(path);
  step();
  const Fd file(::open(fresh.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file) return errno;
  const auto give_up = [&](int error) {
    ::unlink(fresh.c_str());
    return error;
  };
  step();
  if (const int error = write_all(file.get(), wanted.value); error != 0) return give_up(error);
  struct stat made{};
  if (::fstat(file.get(), &made) != 0) return give_up(errno);
  if (exists && (made.st_uid != old.st_uid || made.st_gid != old.st_gid)) {
    step();
    if (::fchown(file.get(), old.st_uid, old.st_gid) != 0) return give_up(errno);
  }
  // Not on a file system without modes (FAT of a boot partition), where they are equal already.
  const mode_t mode = exists ? old.st_mode & 07777U : 0644U;
  step();
  if ((made.st_mode & 07777U) != mode && ::fchmod(file.get(), mode) != 0 && !exists) return give_up(errno);
  step();
  if (::fsync(file.get()) != 0) return give_up(errno);
  step();
  if (::rename(fresh.c_str(), path.c_str()) != 0) return give_up(errno);
  sync_folder_of(path);
  return 0;
}

int Writer::set_value(const std::string& path, const std::string& value) const {
  step();
  const Fd file(::open(path.c_str(), O_WRONLY | O_CLOEXEC | O_TRUNC));
  if (!file) return errno;
  return write_all(file.get(), value + "\n");  // one call: the kernel takes one write as one value
}

int Writer::set_folder(const std::string& path, const Now& wanted) const {
  step();
  return (wanted.absent ? ::rmdir(path.c_str()) : ::mkdir(path.c_str(), 0755)) == 0 ? 0 : errno;
}

int Writer::set_group(const std::string& path, const Now& wanted) const {
  if (const int error = set_folder(path, wanted); error != 0 || wanted.absent) return error;
  const int error = set_value(path + "/cgroup.type", "threaded");
  if (error != 0) (void)set_folder(path, {.absent = true});
  return error;
}

int Writer::set_cores(const Change& change, const std::string& cores) const {
  const int tid = leading_number<int>(change.path.substr(change.path.rfind('/') + 1));
  if (tid <= 0) return ESRCH;
  step();
  return set_allowed_cpus(tid, parse_cpu_list(cores));
}

void Writer::clean(const Change& change) const {
  if (change.kind != ChangeKind::file) return;
  const std::string fresh = new_name(root_ + change.path);
  if (::access(fresh.c_str(), F_OK) != 0) return;
  step();
  ::unlink(fresh.c_str());
}

}  // namespace lithe::host
