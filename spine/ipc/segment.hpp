// SPDX-License-Identifier: Apache-2.0
// Named shared memory: creation, layout check, write lease.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "spine/core/host/fd.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/mapping.hpp"
#include "spine/core/result.hpp"
#include "spine/ipc/layout.hpp"

namespace lithe::ipc {

// Lease, the right to write a segment: a flock on `<segment>.lock`, which the kernel releases when its holder dies. The
// lock file is never deleted, so that two processes cannot lock two different files.
// Contract: movable · never in the tick
class Lease {
 public:
  Lease() = default;

  // Empty if another process holds it, also at a second try: a check holds it for an instant. An error if the lock file
  // cannot be made.
  static Result<std::optional<Lease>> try_take(const std::string& segment_path);
  // True while a process holds it, and when this is unknown: no permission for the lock file, and not all processes are
  // visible (a container).
  static bool is_held(const std::string& segment_path);

 private:
  explicit Lease(Fd lock) : lock_(std::move(lock)) {}
  Fd lock_;
};

// A look at another process's lease, as often as one likes: its lock file stays open.
// Contract: movable · one thread · never in the tick
class LeaseWatch {
 public:
  // An error if the lock file cannot be opened or made.
  static Result<LeaseWatch> open(const std::string& segment_path);
  bool is_held() const;

 private:
  explicit LeaseWatch(Fd lock) : lock_(std::move(lock)) {}
  Fd lock_;
};

enum class Access { read, write };

// A fresh object of `bytes` zeros and a filled header, built under a temporary name and renamed, so that no process
// sees it incomplete. Mode 0660, group `lithe` where there is one.
Result<Mapping> create_mapping(const std::string& path, std::size_t bytes);
// Maps what is there after checking magic, size and layout. A different layout is refused with the fields that differ.
Result<Mapping> attach_mapping(const std::string& path, std::size_t bytes, Access access);
// Makes it read-only for this process: for a creator of a segment that others write.
Result<> make_read_only(const Mapping& mapping);

// Text with the schema lines that `theirs` lacks or has differently; empty if all our fields match. A schema that only
// grew at its end passes.
std::string schema_difference(std::string_view ours, std::string_view theirs);

// One of SpineMemory, ControlMemory, BrainMemory, mapped.
template <class Memory>
class Segment {
 public:
  static std::string path(std::string_view robot) { return shm_path(robot, Memory::kName); }

  static Result<Segment> create(std::string_view robot) { return wrap(create_mapping(path(robot), sizeof(Memory))); }
  static Result<Segment> attach(std::string_view robot, Access access) {
    return wrap(attach_mapping(path(robot), sizeof(Memory), access));
  }

  Memory& operator*() const { return *static_cast<Memory*>(mapping_.data()); }
  Memory* operator->() const { return static_cast<Memory*>(mapping_.data()); }
  const Mapping& mapping() const { return mapping_; }

 private:
  explicit Segment(Mapping mapping) : mapping_(std::move(mapping)) {}
  static Result<Segment> wrap(Result<Mapping> mapping) {
    if (!mapping) return mapping.error();
    return Segment(std::move(*mapping));
  }
  Mapping mapping_;
};

// Marks this process as the segment's writer: its pid, one more epoch, a heartbeat. Call with the lease in hand.
void sign_in(wire::SegmentHeader& header, std::int64_t now_ns);

// Removes the segment's name; who has it mapped keeps it. The lock file stays.
void remove_segment(const std::string& path);

}  // namespace lithe::ipc
