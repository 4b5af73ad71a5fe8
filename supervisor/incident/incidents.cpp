// SPDX-License-Identifier: Apache-2.0
#include "supervisor/incident/incidents.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <limits>
#include <system_error>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/ring.hpp"
#include "supervisor/incident/columns.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;
using wire::CommandResult;
using wire::EventKind;

constexpr std::size_t kMostSummaryBytes = 4'000'000;
constexpr std::size_t kMostEvents = 500, kMostLaws = 32;

// Stops the robot or takes its law away.
bool is_fault(EventKind kind) {
  constexpr EventKind kFaults[] = {EventKind::safe_stop,       EventKind::fault,          EventKind::estop,
                                   EventKind::group_stopped,   EventKind::memory_damaged, EventKind::law_faulted,
                                   EventKind::law_rolled_back, EventKind::params_reverted};
  return contains(kFaults, kind);
}

// Refused in the tick, or a change of mode.
bool is_notable(const wire::Event& event) {
  constexpr EventKind kNotable[] = {EventKind::plan_refused, EventKind::command_refused, EventKind::params_refused,
                                    EventKind::law_refused,  EventKind::armed,           EventKind::disarmed,
                                    EventKind::held,         EventKind::reset,           EventKind::recovering,
                                    EventKind::recovered,    EventKind::law_suspected};
  const auto kind = static_cast<EventKind>(event.kind);
  // At each start the Spine is asked to arm until its drives are ready.
  if (kind == EventKind::command_refused && event.code == static_cast<std::uint32_t>(CommandResult::refused_not_ready))
    return false;
  // A shadow that was refused; the others end as asked.
  return kind == EventKind::shadow_ended ? event.code == 0 : contains(kNotable, kind);
}

// Equal for two events of which one is enough. Faults of different laws and joints are different; the text names the
// joint: "tracking_lost: joint elbow, error ...", "velocity_limit at joint wrist: ...".
std::string same_as(const wire::Event& event) {
  const auto kind = static_cast<EventKind>(event.kind);
  if (!is_fault(kind)) return std::to_string(event.kind);
  const std::string text = text_of(event.text), word = "joint ";
  const std::size_t joint = text.find(word), from = joint == std::string::npos ? 0 : joint + word.size();
  return fmt::format("{} {} {}", event.kind, kind == EventKind::law_faulted ? event.request_id : event.code,
                     text.substr(0, text.find_first_of(" ,:", from)));
}

std::string name_of(std::uint64_t id) { return fmt::format("{:04}", id); }

// Number of an incident's file; 0 = it is not one.
std::uint64_t id_of(const fs::path& path) {
  const std::string stem = path.stem().string();
  const bool is_one = path.extension() == ".json" && stem.size() >= 4 && stem.size() < 10 &&
                      std::ranges::all_of(stem, [](char c) { return c >= '0' && c <= '9'; });
  return is_one ? std::stoull(stem) : 0;
}

// Ascending.
std::vector<std::uint64_t> ids_in(const fs::path& folder) {
  std::vector<std::uint64_t> ids;
  for (const fs::path& path : files_in(folder))
    if (const std::uint64_t id = id_of(path); id != 0) ids.push_back(id);
  std::ranges::sort(ids);
  return ids;
}

Json read_one(const fs::path& folder, std::uint64_t id) {
  const auto text = read_regular_file((folder / (name_of(id) + ".json")).string(), kMostSummaryBytes);
  Json summary = text ? Json::parse(*text, nullptr, false) : Json();
  return summary.is_object() && summary.contains("kind") ? summary : Json();
}

// "" or why not.
std::string put(const fs::path& path, const std::string& bytes) {
  const std::string why = write_file_whole(path.string(), bytes);
  return why.empty() ? "" : fmt::format("cannot write {}: {}", path.string(), why);
}

}  // namespace

// What a summary says of the records. They are not kept: 2 s of them take 8 MB.
struct Incidents::Seen {
  // NaN is left out.
  struct Extremes {
    double least = std::numeric_limits<double>::infinity(), most = -least;
    void add(double value) {
      least = std::min(least, value);
      most = std::max(most, value);
    }
    Json json() const { return Json::array({least, most}); }
  };
  struct Joint {
    Extremes position_rad, velocity_rad_s, command_torque_nm;
    double largest_error_rad = 0;
  };
  wire::Telemetry first, last;
  std::array<Joint, wire::kNj> joints;
  std::size_t ticks = 0;

  void add(const wire::Telemetry& record) {
    if (ticks++ == 0) first = record;
    last = record;
    for (std::size_t j = 0; j < joints.size(); ++j) {
      Joint& joint = joints[j];
      joint.position_rad.add(record.position_rad[j]);
      joint.velocity_rad_s.add(record.velocity_rad_s[j]);
      joint.command_torque_nm.add(record.command_torque_nm[j]);
      const double error_rad = std::abs(record.setpoint_position_rad[j] - record.position_rad[j]);
      joint.largest_error_rad = std::max(joint.largest_error_rad, error_rad);
    }
  }
};

fs::path incidents_of(const std::string& robot) { return fs::absolute(out_dir()) / robot / "incidents"; }

std::vector<Json> read_incidents(const fs::path& folder) {
  std::vector<Json> found;
  for (const std::uint64_t id : ids_in(folder))
    if (Json summary = read_one(folder, id); !summary.is_null()) found.push_back(std::move(summary));
  return found;
}

void Incidents::on_event(const SpineLink& spine, const wire::Event& event, const std::string& line) {
  const auto kind = static_cast<EventKind>(event.kind);
  if (kind == EventKind::law_committed) {
    laws_[event.code] = law(spine, event.code);
    if (laws_.size() > kMostLaws) laws_.erase(laws_.begin());
  }
  if (!is_fault(kind) && !is_notable(event)) return;
  // One at a time: what follows is in the events of the open one, and counted if it is another fault, not the next
  // event of the same. A fault takes the place of what is none.
  if (open_ && (is_fault(static_cast<EventKind>(open_->event.kind)) || !is_fault(kind))) {
    if (is_fault(kind) && event.tick != open_->event.tick) ++skipped_;
    return;
  }
  std::erase_if(last_ns_, [&](const auto& each) { return event.t_ns - each.second >= kPauseNs; });
  if (!last_ns_.try_emplace(same_as(event), event.t_ns).second) {
    ++skipped_;
    return;
  }
  open_ = Open{event, line, kHalfNs};
}

void Incidents::serve(const SpineLink& spine, std::int64_t now_ns) {
  if (!open_) return;
  // The ring must still hold what was before when what comes after is there.
  constexpr double kShare = 0.45;
  const double holds_s = kShare * wire::spine_segment::kTelemetryDepth / spine.info().rate_hz;
  open_->half_ns = std::min(kHalfNs, static_cast<std::int64_t>(1e9 * holds_s));
  const std::int64_t end_ns = open_->event.t_ns + open_->half_ns;
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> reader(spine.memory().telemetry);
  wire::Telemetry newest;
  // A Spine that the machine held back still writes the rest; one that has ended does not.
  const bool complete = reader.latest(newest) && newest.release_ns >= end_ns;
  if (now_ns > end_ns && (complete || now_ns > end_ns + kLateNs)) finish(spine);
}

void Incidents::finish(const SpineLink& spine) {
  if (!open_) return;
  write(spine);
  open_.reset();
}

void Incidents::write(const SpineLink& spine) {
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> reader(spine.memory().telemetry);
  reader.rewind();
  const std::int64_t from_ns = open_->event.t_ns - open_->half_ns, to_ns = open_->event.t_ns + open_->half_ns;
  Seen seen;
  Columns columns(std::min<std::size_t>(spine.info().joint_count, wire::kNj));
  wire::Telemetry record;
  while (!reader.empty() && seen.ticks < wire::spine_segment::kTelemetryDepth) {
    if (!reader.next(record) || record.release_ns < from_ns || record.release_ns > to_ns) continue;
    columns.add(record);
    seen.add(record);
  }
  std::error_code failure;
  fs::create_directories(folder_, failure);
  const std::string data = columns.npy();
  make_room(data.size());
  const auto ids = ids_in(folder_);
  const std::uint64_t id = std::max(last_id_, ids.empty() ? 0 : ids.back()) + 1;
  Json told = summary(spine, seen);
  told["id"] = id;
  told["data"] = name_of(id) + ".npy";
  problem_ = put(folder_ / (name_of(id) + ".npy"), data);
  if (problem_.empty())
    problem_ = put(folder_ / (name_of(id) + ".json"), told.dump(2, ' ', false, Json::error_handler_t::replace) + '\n');
  if (!problem_.empty()) fs::remove(folder_ / (name_of(id) + ".npy"), failure);
  if (problem_.empty()) last_id_ = id;
}

// Deletes the oldest; also data without a summary, which a kill has left. Other people's files stay.
void Incidents::make_room(std::uintmax_t fresh_bytes) const {
  std::error_code failure;
  auto ids = ids_in(folder_);
  for (const fs::path& path : files_in(folder_)) {
    const std::string name = path.filename().string();
    const bool data = path.extension() == ".npy" || path.extension().string().starts_with(".part");
    const bool ours = data && id_of(name.substr(0, name.find('.')) + ".json") != 0;
    if (ours && !fs::exists(fs::path(path).replace_extension(".json"), failure)) fs::remove(path, failure);
  }
  const auto bytes = [&] {
    std::uintmax_t sum = 0;
    for (const std::uint64_t id : ids) {
      const std::uintmax_t size = fs::file_size(folder_ / (name_of(id) + ".npy"), failure);
      sum += failure ? 0 : size;
    }
    return sum;
  };
  while (!ids.empty() && (ids.size() >= kMost || bytes() + fresh_bytes > kMostBytes)) {
    fs::remove(folder_ / (name_of(ids.front()) + ".json"), failure);
    fs::remove(folder_ / (name_of(ids.front()) + ".npy"), failure);
    ids.erase(ids.begin());
  }
}

Json Incidents::summary(const SpineLink& spine, const Seen& seen) const {
  const wire::Event& event = open_->event;
  const wire::RobotInfo& info = spine.info();
  const auto ago_s = std::chrono::nanoseconds(monotonic_ns() - event.t_ns);
  const std::time_t at = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now() - ago_s);
  Json out = {{"kind", std::string(to_string(static_cast<EventKind>(event.kind)))},
              {"what", open_->line},
              {"t_ns", event.t_ns},
              {"tick", event.tick},
              {"time", fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(at))},
              {"rate_hz", info.rate_hz},
              {"ticks", seen.ticks},
              {"skipped_before", skipped_}};
  const auto& [first, last, joints, ticks] = seen;
  if (ticks > 0) {
    out["seconds_before"] = 1e-9 * static_cast<double>(event.t_ns - first.release_ns);
    out["seconds_after"] = 1e-9 * static_cast<double>(last.release_ns - event.t_ns);
    out["ticks_lost"] = last.missed_releases - first.missed_releases;
    out["mode"] = {{"before", std::string(to_string(static_cast<wire::Mode>(first.mode)))},
                   {"after", std::string(to_string(static_cast<wire::Mode>(last.mode)))}};
    out["plan_id"] = last.plan_id;
    out["law"] = {{"before", law(spine, first.law_id)}, {"after", law(spine, last.law_id)}};
  }
  if (const auto running = spine.running_law()) out["params"] = running->values;
  out["joints"] = Json::array();
  for (std::size_t j = 0; j < std::min<std::size_t>(info.joint_count, wire::kNj) && ticks > 0; ++j) {
    out["joints"].push_back({{"name", joint_name(info, j)},
                             {"position_rad", joints[j].position_rad.json()},
                             {"velocity_rad_s", joints[j].velocity_rad_s.json()},
                             {"command_torque_nm", joints[j].command_torque_nm.json()},
                             {"largest_error_rad", joints[j].largest_error_rad}});
  }
  out["events"] = Json::array();
  const Json newest = log_.since(log_.last() > kMostEvents ? log_.last() - kMostEvents : 0, kMostEvents);
  for (const Json& each : newest["events"])
    if (std::abs(each.value("t_ns", std::int64_t{0}) - event.t_ns) <= open_->half_ns) out["events"].push_back(each);
  return out;
}

// null: none, or nothing is known of it any more.
Json Incidents::law(const SpineLink& spine, std::uint32_t law_id) const {
  if (const auto info = spine.law(law_id))
    return {{"name", text_of(info->name)}, {"law_id", law_id}, {"request_id", info->request_id}};
  const auto found = laws_.find(law_id);
  return found != laws_.end() ? found->second : Json();
}

Json Incidents::list() const {
  Json out = brief();
  out["skipped"] = skipped_;
  out["incidents"] = Json::array();
  for (Json& each : read_incidents(folder_)) {
    for (const char* long_one : {"events", "joints", "params"}) each.erase(long_one);
    out["incidents"].push_back(std::move(each));
  }
  return out;
}

std::variant<Json, Refusal> Incidents::show(std::uint64_t id) const {
  const auto ids = ids_in(folder_);
  const std::uint64_t wanted = id == 0 && !ids.empty() ? ids.back() : id;
  Json found = read_one(folder_, wanted);
  if (found.is_null()) {
    return Refusal{"no_incident", fmt::format("there is no incident {} in {}", wanted, folder_.string()),
                   "incidents lists them; the oldest are removed"};
  }
  found["folder"] = folder_.string();
  return found;
}

Json Incidents::brief() const {
  const auto ids = ids_in(folder_);
  return {{"folder", folder_.string()},
          {"last", ids.empty() ? Json() : Json(ids.back())},
          {"problem", problem_.empty() ? Json() : Json(problem_)}};
}

}  // namespace lithe::control
