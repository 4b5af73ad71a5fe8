// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/tried_laws.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "spine/core/host/paths.hpp"

namespace lithe::control {

using swap::Json;

namespace {

// The report of one of the two closed-loop runs; an empty object when there is none.
Json loop_of(const Json& trial) { return trial.value("report", Json::object()).value("loop", Json::object()); }

void compare(const Json& ride, const Json& before, const char* which, const std::string& whom,
             const std::vector<std::string>& joints, std::vector<std::string>& worse) {
  const Json now = ride.value("joint_rms_error_rad", Json::array());
  const Json then = before.value("joint_rms_error_rad", Json::array());
  if (!ride.contains("ticks") || ride["ticks"] != before.value("ticks", Json())) {
    return;  // compare only runs of the same length
  }
  for (std::size_t j = 0; j < std::min({joints.size(), now.size(), then.size()}); ++j) {
    const double now_rad = now[j].get<double>(), then_rad = then[j].get<double>();
    if (now_rad <= kWorseRatio * then_rad + kWorseRad) {
      continue;
    }
    worse.push_back(fmt::format("joint {} follows its setpoint {}worse than {}: {:.3f} rad against {:.3f} (rms), {}",
                                joints[j], now_rad > kMuchWorseRatio * then_rad + kWorseRad ? "much " : "", whom,
                                now_rad, then_rad, which));
  }
}

// The shared object of a law that this supervisor did not commit, found by the hash in the Spine.
std::string cached_object(std::uint64_t source_hash) {
  const std::string begins = fmt::format("{:016x}", source_hash);
  std::error_code failure;
  for (const auto& entry : std::filesystem::directory_iterator(cache_dir() + "/laws", failure)) {
    const std::string name = entry.path().filename().string();
    if (source_hash != 0 && name.starts_with(begins) && name.ends_with(".so")) {
      return entry.path().string();
    }
  }
  return "";
}

}  // namespace

std::vector<std::string> worse_joints(const Json& ride, const Json& before, const std::string& whom,
                                      const std::vector<std::string>& joints) {
  std::vector<std::string> worse;
  if (ride.is_object() && before.is_object()) {
    compare(ride, before, "on the simulated robot", whom, joints, worse);
    compare(ride.value("rough", Json::object()), before.value("rough", Json::object()), "in the rough ride", whom,
            joints, worse);
  }
  return worse;
}

void TriedLaws::passed(std::uint64_t request_id, TrialOrder order, const Json& values, const Json& trial) {
  laws_[request_id] = Law{std::move(order), {Ride{values, loop_of(trial)}}};
  if (laws_.size() > kMostLaws) {
    laws_.erase(laws_.begin());
  }
}

void TriedLaws::passed_again(std::uint64_t request_id, const Json& values, const Json& trial) {
  const auto law = laws_.find(request_id);
  if (law == laws_.end()) {
    return;
  }
  std::deque<Ride>& rides = law->second.rides;
  rides.push_back(Ride{values, loop_of(trial)});
  if (rides.size() > kMostRides) {
    rides.pop_front();
  }
}

std::optional<TrialOrder> TriedLaws::order_of(const RunningLaw& law, const TrialOrder& otherwise) const {
  const auto known = laws_.find(law.info.request_id);
  if (known != laws_.end()) {
    return known->second.order;
  }
  TrialOrder order = otherwise;
  order.object = cached_object(law.info.source_hash);
  return order.object.empty() ? std::nullopt : std::optional(order);
}

std::vector<std::string> TriedLaws::worse_than(const RunningLaw& law, const Json& trial) const {
  const auto known = laws_.find(law.info.request_id);
  if (known == laws_.end()) {
    return {};
  }
  const auto& rides = known->second.rides;
  const auto ride =
      std::find_if(rides.rbegin(), rides.rend(), [&](const Ride& each) { return each.values == law.values; });
  if (ride == rides.rend()) {
    return {};
  }
  const wire::RobotInfo& info = spine_.info();
  std::vector<std::string> joints;
  for (std::size_t j = 0; j < std::min<std::size_t>(info.joint_count, wire::kNj); ++j) {
    joints.push_back(text_of(info.joint_name, j * 32, 32));
  }
  return worse_joints(loop_of(trial), ride->loop, fmt::format("under {}, which runs now", text_of(law.info.name)),
                      joints);
}

}  // namespace lithe::control
