// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/spines.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <system_error>

#include "spine/core/paths.hpp"
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

std::vector<std::string> spines_on(const field::Choice& choice) {
  std::vector<std::string> found;
  for (const std::string& name : robots_with_memory()) {
    const std::string file = file_of(name);
    const auto robot = file.empty() ? Result<robot::RobotConfig>(Error{}) : robot::load_robot(file);
    if (!robot) continue;
    for (const robot::BusConfig& theirs : robot->buses) {
      const auto is_it = [&](std::size_t ours) { return field::same_hardware(choice.robot.buses[ours], theirs); };
      if (std::none_of(choice.buses.begin(), choice.buses.end(), is_it)) continue;
      found.push_back(fmt::format("robot '{}' (bus '{}')", name, theirs.name));
    }
  }
  return found;
}

}  // namespace lithe::cli
