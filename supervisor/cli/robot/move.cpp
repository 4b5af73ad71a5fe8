// SPDX-License-Identifier: Apache-2.0
// `lithe move` and `lithe jog`: this process acts as the robot's Brain while one joint moves to its target.
#include <fmt/format.h>

#include <atomic>
#include <chrono>
#include <numbers>
#include <thread>
#include <utility>

#include "spine/core/time.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/robot/robot.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/talk.hpp"
#include "supervisor/cli/robot/motion.hpp"
#include "supervisor/link/client/presence.hpp"
#include "supervisor/link/spine/commands.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::cli {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;
using Brain = ipc::Segment<ipc::BrainMemory>;

constexpr auto kLookEvery = std::chrono::milliseconds(5);  // and a heartbeat each time
constexpr std::int64_t kSettleNs = kNsPerS;

// The Spine's telemetry, read by the Brain.
struct View {
  explicit View(Spine memory)
      : spine(std::move(memory)),
        telemetry(spine->telemetry),
        events(spine->events_tick),
        info_reader(spine->robot_info) {
    wire::Event old;
    while (events.next(old)) {
    }
  }
  Spine spine;
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry;
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events;
  ipc::ChannelReader<wire::RobotInfo> info_reader;
};

// Refused for on_stale = "safe_stop": such a robot would stop at the end of every move.
void must_not_stop(const std::string& name, const wire::RobotInfo& info) {
  const auto robot = robot::load_robot(control::text_of(info.config_path));
  if (!robot || robot->brain.on_stale != robot::StaleAction::safe_stop) return;
  throw Refusal{"refused_brain",
                fmt::format("robot '{}' is armed only while a Brain lives ([brain] on_stale = \"safe_stop\"); this "
                            "command is one that leaves when the joint is there, and the robot would stop",
                            name),
                "move it from Python, which stays: robot = lithe.connect(); robot.arm() (after a stop robot.reset() "
                "first); robot.go_to(...); or set on_stale = \"hold\""};
}

// Waits until the joint has come to rest at the target, and sends heartbeats.
void follow(View& view, const Brain& brain, const wire::Plan& plan, const wire::RobotInfo& info, wire::Telemetry& now) {
  const std::int64_t until_ns = plan.t_ns[0] + kSettleNs;
  while (monotonic_ns() < until_ns) {
    std::atomic_ref<std::int64_t>(brain->header.heartbeat_ns).store(monotonic_ns(), std::memory_order_release);
    for (wire::Event event; view.events.next(event);) {
      if (event.kind == static_cast<std::uint32_t>(wire::EventKind::plan_refused)) {
        const auto why = static_cast<wire::PlanReject>(event.code);
        const std::string where = control::beyond_limits(plan, why, info);
        throw Refusal{
            "refused_plan",
            fmt::format("the Spine refuses the move: {}{}{}", to_string(why), where.empty() ? "" : "; ", where),
            "more time (--in), or a smaller angle"};
      }
    }
    (void)view.telemetry.latest(now);
    if (now.mode != static_cast<std::uint32_t>(wire::Mode::active)) {
      throw Refusal{
          "refused_mode",
          fmt::format("the move was ended: the robot is in mode {}, fault {}",
                      to_string(static_cast<wire::Mode>(now.mode)), to_string(static_cast<wire::Fault>(now.fault))),
          "see why: lithe status, lithe events"};
    }
    const bool rests = now.plan_state == static_cast<std::uint32_t>(wire::PlanState::hold);
    if (now.plan_id == plan.plan_id && rests && monotonic_ns() > plan.t_ns[0]) return;
    std::this_thread::sleep_for(kLookEvery);
  }
  throw Refusal{"timeout", "the Spine has not come to the end of the move in time", "see what it does: lithe status"};
}

Json go(const std::string& robot, const Motion& motion) {
  auto memory = Spine::attach(robot, ipc::Access::read);
  if (!memory || !ipc::Lease::is_held(Spine::path(robot))) {
    value_of(control::reach(robot));  // says why
    throw Refusal{"robot_fault", memory ? "its Spine is not alive" : memory.message(), "see: lithe list"};
  }
  View view(std::move(*memory));
  wire::RobotInfo info{};
  wire::Telemetry now{};
  if (!view.info_reader.read(info) || !view.telemetry.latest(now))
    throw Refusal{"not_ready", fmt::format("robot '{}' has not ticked yet", robot), "try again in a moment"};
  auto lease = ipc::Lease::try_take(Brain::path(robot));
  const auto brain = Brain::attach(robot, ipc::Access::write);
  if (!lease || !brain)
    throw Refusal{"no_right", lease ? brain.message() : lease.message(), "run it as the robot's owner"};
  if (!lease->has_value()) {
    throw Refusal{"refused_brain",
                  fmt::format("robot '{}' has a Brain already (pid {}): two would pull it to and fro", robot,
                              (*brain)->header.writer_pid),
                  "end that one first, or let it make the move"};
  }
  must_not_stop(robot, info);
  const Move move = value_of(plan_motion(motion, info, now, monotonic_ns()));
  ipc::sign_in((*brain)->header, monotonic_ns());
  ipc::ChannelWriter<wire::Plan>((*brain)->plan).write(move.plan);
  follow(view, *brain, move.plan, info, now);
  return Json{{"robot", robot},
              {"joint", motion.joint},
              {"from_rad", move.from_rad},
              {"to_rad", move.to_rad},
              {"position_rad", now.position_rad[move.joint]},
              {"tick", now.tick}};
}

}  // namespace

int move(const Context& context, const Motion& motion) {
  return finish(context, go(which_robot(context), motion), [](const Json& done) {
    constexpr double kDegPerRad = 180.0 / std::numbers::pi;
    fmt::print("{}: from {:.2f} to {:.2f} deg; it is at {:.2f} deg\n", done["joint"].get<std::string>(),
               done["from_rad"].get<double>() * kDegPerRad, done["to_rad"].get<double>() * kDegPerRad,
               done["position_rad"].get<double>() * kDegPerRad);
  });
}

}  // namespace lithe::cli
