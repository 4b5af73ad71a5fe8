// SPDX-License-Identifier: Apache-2.0
#include "spine/memory.hpp"

#include <fmt/format.h>

#include <optional>
#include <utility>

#include "spine/core/time.hpp"

namespace lithe {

Result<Memory> make_memory(const std::string& robot) {
  const std::string path = ipc::Segment<ipc::SpineMemory>::path(robot);
  Result<std::optional<ipc::Lease>> lease = ipc::Lease::try_take(path);
  if (!lease) return lease.error();
  if (!lease->has_value()) {
    const auto other = ipc::Segment<ipc::SpineMemory>::attach(robot, ipc::Access::read);
    const std::uint64_t pid = other ? (*other)->header.writer_pid : 0;
    return Error{fmt::format("robot '{}' already has a Spine (pid {}); stop it first, or give this robot another name",
                             robot, pid)};
  }
  // Segments of a crashed run are replaced. A process that still maps the old ones sees their heartbeat get old.
  auto spine = ipc::Segment<ipc::SpineMemory>::create(robot);
  if (!spine) return spine.error();
  Result<ipc::LeaseWatch> supervisor = ipc::LeaseWatch::open(ipc::Segment<ipc::ControlMemory>::path(robot));
  if (!supervisor) return supervisor.error();
  auto control = ipc::Segment<ipc::ControlMemory>::create(robot);
  if (!control) return control.error();
  auto brain = ipc::Segment<ipc::BrainMemory>::create(robot);
  if (!brain) return brain.error();
  auto frames = ipc::Segment<ipc::FramesMemory>::create(robot);
  if (!frames) return frames.error();
  ipc::sign_in((*spine)->header, monotonic_ns());
  // Made here, written by supervisor and Brain. Read-only in this process, so that a law cannot set an e-stop word or
  // send a command.
  for (const Mapping* theirs : {&control->mapping(), &brain->mapping()})
    if (const Result<> kept = ipc::make_read_only(*theirs); !kept) return kept.error();
  return Memory{std::move(**lease),  std::move(*supervisor), std::move(*spine),
                std::move(*control), std::move(*brain),      std::move(*frames)};
}

void remove_memory(const std::string& robot) {
  ipc::remove_segment(ipc::Segment<ipc::SpineMemory>::path(robot));
  ipc::remove_segment(ipc::Segment<ipc::ControlMemory>::path(robot));
  ipc::remove_segment(ipc::Segment<ipc::BrainMemory>::path(robot));
  ipc::remove_segment(ipc::Segment<ipc::FramesMemory>::path(robot));
}

}  // namespace lithe
