// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/buses/spines.hpp"

#include <fmt/format.h>

#include <filesystem>
#include <system_error>
#include <utility>

#include "spine/core/time.hpp"
#include "spine/ipc/frames.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/robot/robot.hpp"
#include "supervisor/link/client/client.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::cli {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;

using control::text_of;

// True when the buses of the file are those of the running Spine.
bool is_unchanged(const std::string& name, const robot::RobotConfig& robot) {
  const auto frames = ipc::Segment<ipc::FramesMemory>::attach(name, ipc::Access::read);
  if (!frames) return false;
  const auto& theirs = (*frames)->buses;
  for (std::size_t i = 0; i < theirs.size(); ++i) {
    const std::string here = i < robot.buses.size() ? robot.buses[i].name.substr(0, theirs[i].name.size() - 1) : "";
    if (here != text_of(theirs[i].name)) return false;
  }
  return true;
}

// The robot file of a running Spine. The error says why it cannot be known.
Result<robot::RobotConfig> config_of(const std::string& name) {
  const auto spine = Spine::attach(name, ipc::Access::read);
  if (!spine) return spine.error();
  wire::RobotInfo info{};
  if (!ipc::ChannelReader<wire::RobotInfo>((*spine)->robot_info).read(info)) return Error{"it has not said so yet"};
  Result<robot::RobotConfig> robot = robot::load_robot(text_of(info.config_path));
  if (robot && !is_unchanged(name, *robot)) return Error{robot->path + " names other buses than it was started with"};
  return robot;
}

bool same_path(const std::string& a, const std::string& b) {
  std::error_code unknown;
  return std::filesystem::weakly_canonical(a, unknown) == std::filesystem::weakly_canonical(b, unknown);
}

class SpineFrames final : public bus::FrameSource {
 public:
  SpineFrames(std::string robot, ipc::Segment<ipc::FramesMemory> memory, std::size_t theirs, std::size_t ours)
      : robot_(std::move(robot)),
        memory_(std::move(memory)),
        bus_(theirs < memory_->buses.size() ? text_of(memory_->buses[theirs].name) : ""),
        theirs_(theirs),
        ours_(ours),
        ring_(memory_->ring) {
    ask();
  }

  bool next(bus::CapturedFrame& captured) override {
    ask();
    ipc::FrameRecord record;
    while (ring_.next(record)) {
      if (record.bus != theirs_) continue;
      const auto has = [&](std::uint8_t flag) { return (record.flags & flag) != 0; };
      captured.time_ns = record.time_ns;
      captured.bus = ours_;
      captured.outbound = has(ipc::frame_flag::kOutbound);
      captured.frame = {record.id,
                        record.size,
                        has(ipc::frame_flag::kExtended),
                        has(ipc::frame_flag::kFd),
                        has(ipc::frame_flag::kBrs),
                        record.data};
      return true;
    }
    return false;
  }
  // A Spine started anew has a new segment under the same name.
  std::string why_down() override {
    auto there = ipc::Segment<ipc::FramesMemory>::attach(robot_, ipc::Access::write);
    if (!there || !ipc::Lease::is_held(Spine::path(robot_)))
      return fmt::format("the Spine of robot '{}' has gone; its next one is watched again (lithe run)", robot_);
    if ((*there)->header.created_ns != memory_->header.created_ns) {
      lost_before_ += ring_.lost();
      memory_ = std::move(*there);
      ring_ = Ring(memory_->ring);
      renew_at_ns_ = 0;
      if (!bus_.empty()) theirs_ = number_of(bus_);  // a new Spine may list them in another order
    }
    if (theirs_) return "";
    return fmt::format("the Spine of robot '{}' was started again and has no bus '{}' any more", robot_, bus_);
  }
  std::uint64_t lost() const override { return lost_before_ + ring_.lost(); }
  std::uint64_t errors(std::size_t bus) const override {
    if (bus != ours_ || !theirs_ || *theirs_ >= memory_->buses.size()) return 0;
    const ipc::BusCounts& counts = memory_->buses[*theirs_];
    const auto word = [](const std::uint64_t& each) { return ipc::load_word(each, std::memory_order_relaxed); };
    return word(counts.errors) + word(counts.malformed);
  }

 private:
  // Requested for one second at a time, so that the copying ends soon after a monitor dies.
  void ask() {
    const std::int64_t now_ns = monotonic_ns();
    if (now_ns < renew_at_ns_) return;
    renew_at_ns_ = now_ns + kNsPerS / 4;
    ipc::store_word(memory_->wanted_until_ns.value, static_cast<std::uint64_t>(now_ns + kNsPerS),
                    std::memory_order_relaxed);
  }

  std::optional<std::size_t> number_of(const std::string& bus) const {
    for (std::size_t i = 0; i < memory_->buses.size(); ++i)
      if (text_of(memory_->buses[i].name) == bus) return i;
    return std::nullopt;
  }

  using Ring = ipc::RingReader<ipc::FrameRecord, ipc::FramesMemory::kDepth>;

  std::string robot_;
  ipc::Segment<ipc::FramesMemory> memory_;
  std::string bus_;                    // its name: a Spine started anew may give it another index
  std::optional<std::size_t> theirs_;  // empty = it has no such bus
  std::size_t ours_;
  Ring ring_;
  std::uint64_t lost_before_ = 0;  // of earlier Spines
  std::int64_t renew_at_ns_ = 0;
};

}  // namespace

std::string Occupied::words() const { return fmt::format("robot '{}' (bus '{}')", robot, config.buses[theirs].name); }

std::vector<Occupied> spines_on(const bus::Choice& choice, const std::function<void(const std::string&)>& warn) {
  std::vector<Occupied> found;
  for (const std::string& name : control::robots_with_memory()) {
    if (!ipc::Lease::is_held(Spine::path(name))) continue;
    const Result<robot::RobotConfig> robot = config_of(name);
    if (!robot) {
      warn(fmt::format("robot '{}' runs, or may run; it is not known whether it uses these buses: {}", name,
                       robot.message()));
      continue;
    }
    const bool same_file = choice.from_file && same_path(choice.robot.path, robot->path);
    for (std::size_t theirs = 0; theirs < robot->buses.size(); ++theirs) {
      for (const std::size_t ours : choice.buses) {
        const bool one = bus::same_hardware(choice.robot.buses[ours], robot->buses[theirs]);
        if (one || (same_file && theirs == ours)) found.push_back({name, *robot, theirs, ours});
      }
    }
  }
  return found;
}

Result<std::unique_ptr<bus::FrameSource>> watch_spine(const Occupied& bus) {
  auto frames = ipc::Segment<ipc::FramesMemory>::attach(bus.robot, ipc::Access::write);
  if (!frames) return frames.error();
  return std::unique_ptr<bus::FrameSource>(
      std::make_unique<SpineFrames>(bus.robot, std::move(*frames), bus.theirs, bus.ours));
}

}  // namespace lithe::cli
