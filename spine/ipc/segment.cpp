// SPDX-License-Identifier: Apache-2.0
#include "spine/ipc/segment.hpp"

#include <fcntl.h>
#include <grp.h>
#include <linux/magic.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <set>

#include "spine/core/host/files.hpp"
#include "spine/core/time.hpp"

namespace lithe::ipc {
namespace {

constexpr int kSafely = O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK;  // others may put links and pipes into /dev/shm

// `/dev/shm` outlives a robot: the file may be left by another user's.
Error system_error(const std::string& path, const std::string& what, std::string next) {
  const int why = errno;
  struct stat file{};
  if ((why == EACCES || why == EPERM) && lstat(path.c_str(), &file) == 0 && file.st_uid != geteuid()) {
    next = "the file belongs to " + user_name(file.st_uid) + ", whose robot has or had this name: let " +
           user_name(file.st_uid) + " stop it and remove the file, or give yours another name (LITHE_SHM_PREFIX)";
  }
  return Error{path + ": " + what + " (" + std::strerror(why) + "); " + next};
}

// Shared with the group `lithe` if it exists, otherwise with the owner's group.
void share_with_group(int fd) {
  fchmod(fd, 0660);
  if (const group* lithe = getgrnam("lithe"); lithe != nullptr) {
    if (fchown(fd, static_cast<uid_t>(-1), lithe->gr_gid) != 0) errno = 0;  // not a member: owner only
  }
}

constexpr int kMostTries = 25;
constexpr useconds_t kTryAgainUs = 2'000;

// True when a process holds a lock file that we may not open, from the kernel's list of locks. False only where that
// list is complete (the first pid namespace) and names the file as stat does (tmpfs): else it may be held.
bool may_be_locked(const std::string& path) {
  char space[64] = {};
  struct stat file{};
  struct statfs system{};
  std::ifstream locks("/proc/locks");
  if (!locks || readlink("/proc/self/ns/pid", space, sizeof space - 1) < 0) return true;
  if (std::strcmp(space, "pid:[4026531836]") != 0) return true;  // PROC_PID_INIT_INO of the kernel
  if (stat(path.c_str(), &file) != 0 || statfs(path.c_str(), &system) != 0) return true;
  if (system.f_type != TMPFS_MAGIC) return true;
  char place[64];
  std::snprintf(place, sizeof place, " %02x:%02x:%llu ", major(file.st_dev), minor(file.st_dev),
                static_cast<unsigned long long>(file.st_ino));
  for (std::string line; std::getline(locks, line);)
    if (line.find(place) != std::string::npos) return true;
  return false;
}

void fill_header(wire::SegmentHeader& header, std::size_t bytes) {
  header.magic = wire::kMagic;
  header.abi_major = wire::kAbiMajor;
  header.header_bytes = sizeof(Header);
  header.segment_bytes = bytes;
  header.layout_hash = wire::kLayoutHash;
  header.schema_offset = bytes;
  header.schema_bytes = wire::kCanonicalSchema.size();
  header.joint_capacity = kMaxJoints;
  header.created_ns = monotonic_ns();
}

std::size_t total_bytes(std::size_t bytes) { return bytes + wire::kCanonicalSchema.size(); }

Result<> check(const std::string& path, const unsigned char* data, std::size_t size, std::size_t expected) {
  const auto& header = *reinterpret_cast<const wire::SegmentHeader*>(data);
  if (header.magic != wire::kMagic)
    return Error{path + ": not a LITHE segment; remove the file and start the robot again"};
  if (header.layout_hash == wire::kLayoutHash && header.segment_bytes == expected) return done();
  const std::uint64_t offset = header.schema_offset;
  const std::uint64_t bytes = header.schema_bytes;
  if (offset > size || bytes > size - offset)
    return Error{path + ": its schema text lies outside the segment; remove the file and start the robot again"};
  const std::string_view theirs(reinterpret_cast<const char*>(data) + offset, bytes);
  const std::string difference = schema_difference(wire::kCanonicalSchema, theirs);
  if (difference.empty() && header.segment_bytes >= expected) return done();
  return Error{path + ": made by a build with another layout:\n" + difference +
               "build both sides from the same schema/wire.toml, then start the robot again"};
}

Result<Fd> open_lock(const std::string& segment_path) {
  const std::string path = segment_path + ".lock";
  // Without O_CREAT first: with it, the kernel refuses the file of another member of the group (fs.protected_regular).
  Fd lock(open(path.c_str(), O_RDWR | kSafely));
  if (!lock && errno == ENOENT) lock.reset(open(path.c_str(), O_RDWR | O_CREAT | kSafely, 0660));
  if (!lock) return system_error(path, "cannot open the lock file", "check the rights of /dev/shm");
  share_with_group(lock.get());
  return lock;
}

}  // namespace

Result<std::optional<Lease>> Lease::try_take(const std::string& segment_path) {
  Result<Fd> lock = open_lock(segment_path);
  if (!lock) return lock.error();
  for (int tries = 1; flock(lock->get(), LOCK_EX | LOCK_NB) != 0; ++tries) {
    if (tries == kMostTries) return std::optional<Lease>();
    usleep(kTryAgainUs);
  }
  return std::optional<Lease>(Lease(std::move(*lock)));
}

bool Lease::is_held(const std::string& segment_path) {
  const std::string path = segment_path + ".lock";
  const Fd lock(open(path.c_str(), O_RDONLY | kSafely));  // the trial's filter lets nothing be opened to write
  if (!lock) return errno == EACCES && may_be_locked(path);
  return flock(lock.get(), LOCK_SH | LOCK_NB) != 0;  // shared: two checks at the same time do not see each other
}

Result<LeaseWatch> LeaseWatch::open(const std::string& segment_path) {
  Result<Fd> lock = open_lock(segment_path);
  if (!lock) return lock.error();
  return LeaseWatch(std::move(*lock));
}

bool LeaseWatch::is_held() const {
  if (flock(lock_.get(), LOCK_SH | LOCK_NB) != 0) return true;
  flock(lock_.get(), LOCK_UN);
  return false;
}

Result<> make_read_only(const Mapping& mapping) {
  if (mprotect(mapping.data(), mapping.size(), PROT_READ) == 0) return done();
  return Error{std::string("a segment stays writable: ") + std::strerror(errno)};
}

Result<Mapping> create_mapping(const std::string& path, std::size_t bytes) {
  const std::string making = path + "." + std::to_string(getpid());
  unlink(making.c_str());  // left by a process that died while making it, and had our pid
  const Fd file(open(making.c_str(), O_RDWR | O_CREAT | O_EXCL | kSafely, 0660));
  if (!file) return system_error(making, "cannot create shared memory", "check the rights and the space of /dev/shm");
  share_with_group(file.get());
  const std::size_t size = total_bytes(bytes);
  // posix_fallocate and not ftruncate: a full /dev/shm must fail here and not as a SIGBUS in the tick.
  errno = posix_fallocate(file.get(), 0, static_cast<off_t>(size));
  void* data =
      errno == 0 ? mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, file.get(), 0) : MAP_FAILED;
  if (data == MAP_FAILED) {
    Error error = system_error(making, "cannot get " + std::to_string(size) + " bytes of shared memory",
                               "free some space in /dev/shm");
    unlink(making.c_str());
    return error;
  }
  Mapping mapping(data, size);
  std::memcpy(mapping.bytes() + bytes, wire::kCanonicalSchema.data(), wire::kCanonicalSchema.size());
  fill_header(*static_cast<wire::SegmentHeader*>(data), bytes);
  if (rename(making.c_str(), path.c_str()) != 0) {
    Error error = system_error(path, "cannot put the segment in place", "check the rights of /dev/shm");
    unlink(making.c_str());
    return error;
  }
  return mapping;
}

Result<Mapping> attach_mapping(const std::string& path, std::size_t bytes, Access access) {
  const bool write = access == Access::write;
  const Fd file(open(path.c_str(), (write ? O_RDWR : O_RDONLY) | kSafely));
  if (!file) {
    return system_error(path, "cannot open shared memory",
                        errno == ENOENT ? "start the robot first: lithe run ROBOT.toml" : "are you in group 'lithe'?");
  }
  struct stat status{};
  if (fstat(file.get(), &status) != 0 || static_cast<std::size_t>(status.st_size) < sizeof(Header))
    return Error{path + ": too short for a LITHE segment; remove the file and start the robot again"};
  const auto size = static_cast<std::size_t>(status.st_size);
  void* data =
      mmap(nullptr, size, write ? PROT_READ | PROT_WRITE : PROT_READ, MAP_SHARED | MAP_POPULATE, file.get(), 0);
  if (data == MAP_FAILED) return system_error(path, "cannot map shared memory", "check `ulimit -v`");
  Mapping mapping(data, size);
  if (size < bytes) return Error{path + ": shorter than its layout; remove the file and start the robot again"};
  if (Result<> checked = check(path, static_cast<const unsigned char*>(data), size, bytes); !checked)
    return checked.error();
  return mapping;
}

std::string schema_difference(std::string_view ours, std::string_view theirs) {
  const auto lines = [](std::string_view text) {
    std::set<std::string_view> result;
    while (!text.empty()) {
      const std::size_t end = std::min(text.find('\n'), text.size());
      result.insert(text.substr(0, end));
      text.remove_prefix(std::min(end + 1, text.size()));
    }
    return result;
  };
  const std::set<std::string_view> mine = lines(ours);
  const std::set<std::string_view> other = lines(theirs);
  std::string difference;
  for (const std::string_view line : mine) {
    if (other.contains(line)) continue;
    const std::string_view name = line.substr(0, line.find(':') + 1);
    const auto same_name = other.lower_bound(name);
    const bool renamed = same_name == other.end() || !same_name->starts_with(name);
    difference +=
        "  here  " + std::string(line) + "\n  there " + (renamed ? "(absent)" : std::string(*same_name)) + "\n";
  }
  return difference;
}

void sign_in(wire::SegmentHeader& header, std::int64_t now_ns) {
  store_word(header.writer_pid, static_cast<std::uint64_t>(getpid()), std::memory_order_relaxed);
  store_word(header.epoch, load_word(header.epoch, std::memory_order_relaxed) + 1, std::memory_order_relaxed);
  std::atomic_ref<std::int64_t>(header.heartbeat_ns).store(now_ns, std::memory_order_release);
}

void remove_segment(const std::string& path) { unlink(path.c_str()); }

}  // namespace lithe::ipc
