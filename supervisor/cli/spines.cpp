// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/spines.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "spine/core/paths.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/frames.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::cli {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;

// The file that a living Spine was started with; empty: there is none, or it does not say.
std::string file_of(const std::string& robot) {
  if (!ipc::Lease::is_held(Spine::path(robot))) return "";
  const auto spine = Spine::attach(robot, ipc::Access::read);
  wire::RobotInfo info{};
  if (!spine || !ipc::ChannelReader<wire::RobotInfo>((*spine)->robot_info).read(info)) return "";
  const auto end = std::find(info.config_path.begin(), info.config_path.end(), '\0');
  return {info.config_path.begin(), end};
}

bool same_path(const std::string& a, const std::string& b) {
  std::error_code unknown;
  return std::filesystem::weakly_canonical(a, unknown) == std::filesystem::weakly_canonical(b, unknown);
}

class SpineFrames final : public field::FrameSource {
 public:
  SpineFrames(ipc::Segment<ipc::FramesMemory> memory, std::size_t theirs, std::size_t ours)
      : memory_(std::move(memory)), theirs_(theirs), ours_(ours), ring_(memory_->ring) {
    ask();
  }

  bool next(field::Sighting& sighting) override {
    ask();
    ipc::FrameRecord record;
    while (ring_.next(record)) {
      if (record.bus != theirs_) continue;
      const auto has = [&](std::uint8_t flag) { return (record.flags & flag) != 0; };
      sighting.time_ns = record.time_ns;
      sighting.bus = ours_;
      sighting.outbound = has(ipc::frame_flag::kOutbound);
      sighting.frame = {record.id,
                        record.size,
                        has(ipc::frame_flag::kExtended),
                        has(ipc::frame_flag::kFd),
                        has(ipc::frame_flag::kBrs),
                        record.data};
      return true;
    }
    return false;
  }
  std::uint64_t lost() const override { return ring_.lost(); }
  std::uint64_t errors(std::size_t bus) const override {
    if (bus != ours_ || theirs_ >= memory_->buses.size()) return 0;
    const ipc::BusCounts& counts = memory_->buses[theirs_];
    const auto word = [](const std::uint64_t& each) { return ipc::load_word(each, std::memory_order_relaxed); };
    return word(counts.errors) + word(counts.malformed);
  }

 private:
  // A second at a time, so that a monitor that dies is not heard out for long.
  void ask() {
    const std::int64_t now_ns = monotonic_ns();
    if (now_ns < renew_at_ns_) return;
    renew_at_ns_ = now_ns + kNsPerS / 4;
    ipc::store_word(memory_->wanted_until_ns.value, static_cast<std::uint64_t>(now_ns + kNsPerS),
                    std::memory_order_relaxed);
  }

  ipc::Segment<ipc::FramesMemory> memory_;
  std::size_t theirs_;
  std::size_t ours_;
  ipc::RingReader<ipc::FrameRecord, ipc::FramesMemory::kDepth> ring_;
  std::int64_t renew_at_ns_ = 0;
};

}  // namespace

std::set<std::string> robots_with_memory() {
  const std::filesystem::path pattern = shm_path("*", "control");
  const std::string file = pattern.filename().string();
  const std::string before = file.substr(0, file.find('*'));
  const std::string after = file.substr(file.find('*') + 1);
  std::set<std::string> robots;
  std::error_code failure;
  for (std::filesystem::directory_iterator at(pattern.parent_path(), failure), end; !failure && at != end;
       at.increment(failure)) {
    const std::string name = at->path().filename().string();
    if (name.size() > before.size() + after.size() && name.starts_with(before) && name.ends_with(after)) {
      robots.insert(name.substr(before.size(), name.size() - before.size() - after.size()));
    }
  }
  return robots;
}

std::string Occupied::words() const { return fmt::format("robot '{}' (bus '{}')", robot, config.buses[theirs].name); }

std::vector<Occupied> spines_on(const field::Choice& choice) {
  std::vector<Occupied> found;
  for (const std::string& name : robots_with_memory()) {
    const std::string file = file_of(name);
    const auto robot = file.empty() ? Result<robot::RobotConfig>(Error{}) : robot::load_robot(file);
    if (!robot) continue;
    const bool same_file = choice.from_file && same_path(choice.robot.path, file);
    for (std::size_t theirs = 0; theirs < robot->buses.size(); ++theirs) {
      for (const std::size_t ours : choice.buses) {
        const bool one = field::same_hardware(choice.robot.buses[ours], robot->buses[theirs]);
        if (one || (same_file && theirs == ours)) found.push_back({name, *robot, theirs, ours});
      }
    }
  }
  return found;
}

Result<std::unique_ptr<field::FrameSource>> watch_spine(const Occupied& bus) {
  auto frames = ipc::Segment<ipc::FramesMemory>::attach(bus.robot, ipc::Access::write);
  if (!frames) return frames.error();
  return std::unique_ptr<field::FrameSource>(std::make_unique<SpineFrames>(std::move(*frames), bus.theirs, bus.ours));
}

}  // namespace lithe::cli
