// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/tried_laws.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"

namespace lithe::control {

namespace {

// The report of one of the two closed-loop runs; an empty object when there is none.
Json loop_of(const Json& trial) { return trial.value("report", Json::object()).value("loop", Json::object()); }

void compare(const Json& run, const Json& before, const char* which, const std::string& whom,
             const std::vector<std::string>& joints, std::vector<std::string>& worse) {
  const Json now = run.value("joint_rms_error_rad", Json::array());
  const Json then = before.value("joint_rms_error_rad", Json::array());
  if (!run.contains("ticks") || run["ticks"] != before.value("ticks", Json()))
    return;  // compare only runs of the same length
  for (std::size_t j = 0; j < std::min({joints.size(), now.size(), then.size()}); ++j) {
    const double now_rad = now[j].get<double>(), then_rad = then[j].get<double>();
    if (now_rad <= kWorseRatio * then_rad + kWorseRad) continue;
    worse.push_back(fmt::format("joint {} follows its setpoint {}worse than {}: {:.3f} rad against {:.3f} (rms), {}",
                                joints[j], now_rad > kMuchWorseRatio * then_rad + kWorseRad ? "much " : "", whom,
                                now_rad, then_rad, which));
  }
}

// The shared object of a law that this supervisor did not commit, found by the hash in the Spine.
std::string cached_object(std::uint64_t source_hash) {
  const std::string begins = fmt::format("{:016x}", source_hash);
  for (const std::filesystem::path& path : files_in(cache_dir() + "/laws")) {
    const std::string name = path.filename().string();
    if (source_hash != 0 && name.starts_with(begins) && name.ends_with(".so")) return path.string();
  }
  return "";
}

}  // namespace

std::vector<std::string> worse_joints(const Json& run, const Json& before, const std::string& whom,
                                      const std::vector<std::string>& joints) {
  std::vector<std::string> worse;
  if (run.is_object() && before.is_object()) {
    compare(run, before, "on the simulated robot", whom, joints, worse);
    compare(run.value("rough", Json::object()), before.value("rough", Json::object()),
            "in the rough run (pushed, 20 % heavier, noisy sensors, one tick later)", whom, joints, worse);
  }
  return worse;
}

std::string missing_sensor(const Json& values, const wire::RobotInfo& info) {
  const std::uint32_t count = std::min<std::uint32_t>(info.sensor_count, wire::kNs);
  const double sensor = values.value("sensor", 0.0);
  if (!values.contains("sensor") || (sensor >= 0 && sensor < count)) return "";
  std::string there;
  for (std::uint32_t i = 0; i < count; ++i)
    there += fmt::format("{}{} {}", i == 0 ? "" : ", ", i, name_at(info.sensor_name, i));
  const std::string file = text_of(info.config_path);
  if (there.empty()) {
    return fmt::format(
        "sensor = {:g} is no sensor of this robot, which has none, so the law reacts to nothing: set one up as "
        "[[sensor]] in {} (docs/hardware.md, Sensors), start the robot again, then lithe param set sensor 0",
        sensor, file);
  }
  return fmt::format(
      "sensor = {:g} is no sensor of this robot, so the law reacts to nothing: it has {}: lithe param set sensor "
      "NUMBER; "
      "or set up another as [[sensor]] in {} (docs/hardware.md, Sensors), and start the robot again",
      sensor, there, file);
}

void TriedLaws::passed(std::uint64_t request_id, TrialRequest request, const Json& values, const Json& trial) {
  laws_[request_id] = Law{std::move(request), {Run{values, loop_of(trial)}}};
  if (laws_.size() > kMostLaws) laws_.erase(laws_.begin());
}

void TriedLaws::passed_again(std::uint64_t request_id, const Json& values, const Json& trial) {
  const auto law = laws_.find(request_id);
  if (law == laws_.end()) return;
  std::deque<Run>& runs = law->second.runs;
  runs.push_back(Run{values, loop_of(trial)});
  if (runs.size() > kMostRuns) runs.pop_front();
}

std::optional<TrialRequest> TriedLaws::request_of(const RunningLaw& law, const TrialRequest& otherwise) const {
  const auto known = laws_.find(law.info.request_id);
  if (known != laws_.end()) return known->second.request;
  TrialRequest request = otherwise;
  request.object = cached_object(law.info.source_hash);
  return request.object.empty() ? std::nullopt : std::optional(request);
}

std::optional<TrialRequest> TriedLaws::again(std::uint64_t request_id) const {
  const auto known = laws_.find(request_id);
  if (known == laws_.end()) return std::nullopt;
  TrialRequest request = known->second.request;
  request.placed = {};
  request.params = known->second.runs.back().values;
  return request;
}

std::vector<std::string> TriedLaws::worse_than(const RunningLaw& law, const Json& trial) const {
  const auto known = laws_.find(law.info.request_id);
  if (known == laws_.end()) return {};
  const auto& runs = known->second.runs;
  const auto run = std::find_if(runs.rbegin(), runs.rend(), [&](const Run& each) { return each.values == law.values; });
  if (run == runs.rend()) return {};
  const wire::RobotInfo& info = spine_.info();
  std::vector<std::string> joints;
  for (std::size_t j = 0; j < std::min<std::size_t>(info.joint_count, wire::kNj); ++j)
    joints.push_back(joint_name(info, j));
  return worse_joints(loop_of(trial), run->loop, fmt::format("under {}, which runs now", text_of(law.info.name)),
                      joints);
}

}  // namespace lithe::control
