// SPDX-License-Identifier: Apache-2.0
#include "bench/rig/spine_rig.hpp"

#include <cmath>
#include <ctime>
#include <span>
#include <utility>

#include "bench/rig/pages.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/loop/transport.hpp"
#include "spine/robot/robot.hpp"

extern "C" const LitheLaw lithe_law;  // laws/pd.cpp, compiled in

namespace lithe::bench {
namespace {

constexpr std::int64_t kPlanIntervalNs = 20 * kNsPerMs;
constexpr std::uint64_t kStateTicks = 10;  // at 1 kHz a tick publishes its law's State this often

// The next 320 ms of a 0.5 Hz sine on every joint.
void fill_plan(wire::Plan& plan, std::uint32_t joints, std::int64_t now_ns) {
  ++plan.plan_id;
  plan.waypoint_count = wire::kNw;
  plan.joint_count = joints;
  plan.streaming = 1;
  for (std::size_t w = 0; w < wire::kNw; ++w) {
    plan.t_ns[w] = now_ns + static_cast<std::int64_t>(w) * kPlanIntervalNs;
    const double angle_rad = 0.3 * std::sin(3.14159 * static_cast<double>(plan.t_ns[w]) * 1e-9);
    for (std::size_t j = 0; j < joints; ++j) {
      plan.position_rad[w * kMaxJoints + j] = angle_rad;
      plan.velocity_rad_s[w * kMaxJoints + j] = std::nan("");
    }
  }
}

// The words of the telemetry record that is written next.
std::span<std::uint64_t> next_record(ipc::SpineMemory& memory) {
  const std::uint64_t count = ipc::load_word(memory.telemetry.head, std::memory_order_relaxed);
  auto& slot = memory.telemetry.slots[count % memory.telemetry.slots.size()];
  return {reinterpret_cast<std::uint64_t*>(&slot), sizeof slot / sizeof(std::uint64_t)};
}

}  // namespace

SpineRig::SpineRig(const std::string& robot_file, Cores cores)
    : SpineRig(or_exit(robot::load_robot(robot_file)), cores) {}

SpineRig::SpineRig(robot::RobotConfig config, Cores cores, bool transport_inline) : config_(std::move(config)) {
  actuators_ = or_exit(hal::sim::open_actuators(config_));
  loop::start_clock(*clock_);  // and no keeper: the tick and the bench must read one and the same fit
  for (std::uint32_t i = 0; i < law::kResidents; ++i) {
    (*laws_)[i].index = i;
    free_.push_back(&(*laws_)[i]);
  }
  offer_copy();
  or_exit(contain::install_handlers());
  barrier_.emplace(or_exit(contain::FaultBarrier::open()));
  sandbox_.emplace(or_exit(law::SandboxMemory::make()));
  const loop::Wiring wiring{config_,    *memory_,   *control_, *brain_, slot_,
                            **sandbox_, &*barrier_, handover_, *clock_, transport_inline ? actuators_.get() : nullptr};
  spine_ = std::make_unique<loop::Spine>(wiring);
  law::reset_resident(*written_law_, lithe_law);
  writer_.emplace(*written_, static_cast<std::uint32_t>(config_.joints.size()));
  if (!transport_inline) transport_ = on_core(cores.partner, [this] { serve_buses(); });
  brain_thread_ = on_core(cores.partner, [this] { publish_plans(); });
}

SpineRig::~SpineRig() {
  stop_.store(true);
  for (std::thread* thread : {&transport_, &brain_thread_})
    if (thread->joinable()) thread->join();
}

void SpineRig::serve_buses() { loop::run_transport(handover_, *actuators_, *clock_, false, stop_); }

void SpineRig::publish_plans() {
  ipc::ChannelWriter<wire::Plan> writer(brain_->plan);
  auto plan = std::make_unique<wire::Plan>();
  constexpr timespec kInterval{0, kPlanIntervalNs};
  while (!stop_.load(std::memory_order_relaxed)) {
    const std::int64_t now_ns = monotonic_ns();
    fill_plan(*plan, static_cast<std::uint32_t>(config_.joints.size()), now_ns);
    writer.write(*plan);
    if (swapping_.load(std::memory_order_relaxed)) offer_copy();
    std::atomic_ref<std::int64_t>(brain_->header.heartbeat_ns).store(now_ns, std::memory_order_release);
    nanosleep(&kInterval, nullptr);
  }
}

// As the Loader does it, but without code to load: a fresh copy of the law, and how its State is carried.
void SpineRig::offer_copy() {
  while (law::Resident* gone = slot_.collect_retired()) {
    gone->law_id = 0;
    free_.push_back(gone);
  }
  if (free_.empty()) return;
  law::Resident& copy = *free_.back();
  law::reset_resident(copy, lithe_law);
  copy.law_id = static_cast<std::uint32_t>(offers_.load()) + 1;
  for (const law::Resident& peer : *laws_)
    if (&peer != &copy && peer.law_id != 0) law::plan_migrations(copy, peer);
  if (!slot_.offer(&copy)) {
    copy.law_id = 0;  // the tick has not taken the one before
    return;
  }
  free_.pop_back();
  ++offers_;
}

void SpineRig::order(wire::CommandKind kind) {
  wire::Command command{};
  command.kind = static_cast<std::uint32_t>(kind);
  commands_.send(command);
  std::vector<Cycle> not_counted;
  tick_block(100 * kNsPerMs, not_counted);
}

// A stall of the machine may make the guard stop the robot at any time, so this is done before every block.
void SpineRig::arm() {
  for (int attempt = 0; attempt < 20 && spine_->mode() != wire::Mode::active; ++attempt) {
    order(wire::CommandKind::reset);
    order(wire::CommandKind::arm);
  }
  if (spine_->mode() != wire::Mode::active) give_up("the rig of " + config_.path + " cannot be armed");
}

void SpineRig::run_block(std::int64_t block_ns, std::vector<Cycle>& cycles) {
  arm();
  tick_block(block_ns, cycles);
}

void SpineRig::tick_block(std::int64_t block_ns, std::vector<Cycle>& cycles) {
  loop::SteeredClock clock(*clock_);
  ipc::RingReader telemetry(memory_->telemetry);
  wire::Telemetry record{};
  const std::int64_t period_ns = spine_period_ns(config_.rate_hz);
  bench::run_block(
      clock, period_ns, config_.spine.phase_ns, block_ns, cycles,
      [&](std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped, Cycle& cycle, Cycle* before) {
        cycle.page_ns = touch_ns(clock, next_record(*memory_));
        spine_->tick(release_ns, woke_ns, skipped);
        spine_->serve_inline();
        const std::uint32_t law_before_ns = record.law_ns;
        telemetry.latest(record);
        cycle.handoff_ns = record.handoff_ns;
        // Inline, a hand-off is that of the tick before, which would have touched these pages itself.
        if (!transport_.joinable() && before != nullptr) cycle.handoff_ns += before->page_ns;
        cycle.bus_ns = record.bus_ns;
        // tick_ns is that of the tick before: the record is written before its own tick ends.
        if (before != nullptr) before->cost_ns = std::int64_t{record.tick_ns} - law_before_ns;
      });
}

void SpineRig::run_bare_block(std::int64_t block_ns, std::vector<Cycle>& cycles) {
  loop::SteeredClock clock(*clock_);
  bench::run_block(clock, spine_period_ns(config_.rate_hz), config_.spine.phase_ns, block_ns, cycles,
                   [](std::int64_t, std::int64_t, std::uint32_t, Cycle&, Cycle*) {});
}

void SpineRig::run_writing_block(std::int64_t block_ns, std::vector<Cycle>& cycles) {
  loop::SteeredClock clock(*clock_);
  std::uint64_t& tick = writer_->record().tick;
  bench::run_block(clock, spine_period_ns(config_.rate_hz), config_.spine.phase_ns, block_ns, cycles,
                   [&](std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t, Cycle& cycle, Cycle*) {
                     cycle.page_ns = touch_ns(clock, next_record(*written_));
                     writer_->heartbeat(woke_ns);
                     writer_->publish({.release_jitter_ns = woke_ns - release_ns}, true);
                     if (++tick % kStateTicks == 0) writer_->state(*written_law_);
                   });
}

}  // namespace lithe::bench
