// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/client/client.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <filesystem>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/segment.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;
using Control = ipc::Segment<ipc::ControlMemory>;
using Supervisor = Presence::Supervisor;

constexpr std::int64_t kLookNs = 400 * kNsPerMs;  // forty ticks of the slowest Spine
constexpr useconds_t kLookAgainUs = 2'000;

void look_at_spine(Presence& out) {
  out.spine_pid = spine_now(out.robot);
  if (!out.spine_pid) return;
  const auto spine = Spine::attach(out.robot, ipc::Access::read);
  if (!spine) {
    out.unreadable = spine.message();
    return;
  }
  const ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry((*spine)->telemetry);
  wire::Telemetry now{};
  const bool any = telemetry.latest(now);
  const std::uint64_t first = now.tick;
  const std::int64_t until_ns = monotonic_ns() + kLookNs;
  while (any && now.tick == first && monotonic_ns() < until_ns) {
    ::usleep(kLookAgainUs);
    (void)telemetry.latest(now);
  }
  out.ticks = now.tick != first;
  out.tick = now.tick;
  if (any) {
    out.mode = to_string(static_cast<wire::Mode>(now.mode));
    out.fault = to_string(static_cast<wire::Fault>(now.fault));
  }
  wire::RobotInfo info{};
  if (ipc::ChannelReader<wire::RobotInfo>((*spine)->robot_info).read(info)) out.config = text_of(info.config_path);
  for (const auto& memory : (*spine)->law_info) {
    wire::LawInfo law{};
    if (ipc::ChannelReader<wire::LawInfo>(memory).read(law) && law.law_id != 0 && law.law_id == now.law_id)
      out.law = text_of(law.name);
  }
}

// The connection, when the supervisor answers.
std::optional<Client> look_at_supervisor(Presence& out) {
  auto client = Client::connect(control_socket_path(out.robot));
  if (client) {
    out.supervisor_pid = client->peer_pid();
    const Client::Pulse pulse = client->pulse();
    if (pulse == Client::Pulse::answers) {
      out.supervisor = Supervisor::answers;
      return std::move(*client);
    }
    if (pulse != Client::Pulse::gone) {
      out.supervisor = pulse == Client::Pulse::stopped ? Supervisor::stopped : Supervisor::silent;
      return std::nullopt;
    }
  }
  if (ipc::Lease::is_held(Control::path(out.robot))) {
    out.supervisor_pid = noted_supervisor(out.robot);
    out.supervisor = Client::is_full(client) ? Supervisor::silent : Supervisor::starting;
  }
  return std::nullopt;
}

// "Spine pid 17 ticks: mode active, tick 4711".
std::string about_spine(const Presence& there) {
  if (!there.spine_pid) return "no Spine ticks";
  const std::string who = *there.spine_pid > 0 ? fmt::format("pid {}", *there.spine_pid) : "pid unknown";
  if (!there.unreadable.empty())
    return fmt::format("its Spine ({}) lives; what it does cannot be read: {}", who, there.unreadable);
  return there.ticks ? fmt::format("its Spine ({}) ticks: mode {}, tick {}", who, there.mode, there.tick)
                     : fmt::format("its Spine ({}) lives but does not tick", who);
}

std::string run_it(const Presence& there) {
  return fmt::format("lithe run {}", there.config.empty() ? "ROBOT.toml" : there.config);
}

Refusal refusal(const Presence& there, const char* code, std::string message, std::string next) {
  return {code, std::move(message), std::move(next), presence_json(there)};
}

// The refusal for a robot whose supervisor does not answer.
Refusal why_silent(const Presence& there) {
  const std::string& name = there.robot;
  const std::string who = there.supervisor_pid > 0 ? fmt::format("pid {}", there.supervisor_pid) : "pid unknown";
  const std::string go_on = there.supervisor_pid > 0
                                ? fmt::format("kill -CONT {}, or fg in its shell", there.supervisor_pid)
                                : "fg in its shell";
  switch (there.supervisor) {
    case Supervisor::stopped:
      return refusal(there, "no_answer",
                     fmt::format("the supervisor of '{}' ({}) is stopped (Ctrl-Z?), and nothing was asked of it; {}",
                                 name, who, about_spine(there)),
                     fmt::format("let it go on: {}; the e-stop works without it: lithe estop", go_on));
    case Supervisor::silent:
      return refusal(there, "no_answer",
                     fmt::format("the supervisor of '{}' ({}) does not answer, and nothing was asked of it; {}", name,
                                 who, about_spine(there)),
                     "is the machine too busy? Try again; end it (the robot continues) and start it again: " +
                         run_it(there) + "; the e-stop works without it: lithe estop");
    case Supervisor::starting:
      return refusal(
          there, "starting",
          fmt::format(
              "the supervisor of '{}' ({}) takes no commands: it starts or stops, or its socket was removed; {}", name,
              who, about_spine(there)),
          "try again in a second: a socket that was removed is made again. If it stays so: has `lithe run` "
          "another LITHE_RUN_DIR? See its log; the e-stop works without it: lithe estop");
    case Supervisor::answers:
    case Supervisor::none:
      break;
  }
  if (there.spine_pid) {
    return refusal(there, "no_supervisor",
                   fmt::format("robot '{}' has no supervisor, and {}", name, about_spine(there)),
                   fmt::format("take it over, as it is: {}; or stop its motion: lithe estop", run_it(there)));
  }
  return {"no_robot", fmt::format("no robot '{}' is running here (looked in {})", name, run_dir()),
          "start it: lithe run ROBOT.toml; which run: lithe list"};
}

}  // namespace

const char* word(Presence::Supervisor supervisor) {
  const char* const words[] = {"none", "starting or stopping", "answers", "stopped", "silent"};
  return words[static_cast<std::size_t>(supervisor)];
}

Presence look_for(const std::string& robot) {
  Presence out;
  out.robot = robot;
  look_at_supervisor(out);
  look_at_spine(out);
  return out;
}

std::variant<Client, Refusal> reach(const std::string& robot) {
  Presence there;
  there.robot = robot;
  if (auto client = look_at_supervisor(there)) return std::move(*client);
  look_at_spine(there);
  return why_silent(there);
}

bool is_unreachable(const Refusal& refusal) {
  static const std::set<std::string> codes = {"no_robot", "no_supervisor", "no_answer", "starting"};
  return codes.count(refusal.code) != 0;
}

Json presence_json(const Presence& there) {
  return {{"robot", there.robot},
          {"supervisor", word(there.supervisor)},
          {"supervisor_pid", there.supervisor_pid},
          {"spine_pid", there.spine_pid ? Json(*there.spine_pid) : Json(nullptr)},
          {"ticks", there.unreadable.empty() ? Json(there.ticks) : Json(nullptr)},
          {"tick", there.tick},
          {"mode", there.mode},
          {"fault", there.fault},
          {"law", there.law},
          {"config", there.config}};
}

std::set<std::string> robots_with_memory() {
  const std::filesystem::path pattern = shm_path("*", "control");
  const std::string file = pattern.filename().string();
  const std::string before = file.substr(0, file.find('*'));
  const std::string after = file.substr(file.find('*') + 1);
  std::set<std::string> robots;
  for (const std::filesystem::path& path : files_in(pattern.parent_path())) {
    const std::string name = path.filename().string();
    if (name.size() > before.size() + after.size() && name.starts_with(before) && name.ends_with(after))
      robots.insert(name.substr(before.size(), name.size() - before.size() - after.size()));
  }
  return robots;
}

std::set<std::string> known_robots() {
  std::set<std::string> names = robots_with_memory();
  for (const std::filesystem::path& path : files_in(run_dir()))
    if (path.extension() == ".sock" || path.extension() == ".pid") names.insert(path.stem());
  return names;
}

}  // namespace lithe::control
