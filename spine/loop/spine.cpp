// SPDX-License-Identifier: Apache-2.0
// The run from the first to the last release.
#include "spine/loop/spine.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace lithe::loop {
namespace {

// How often the law's State is published: as often as a Brain publishes plans.
constexpr double kStateHz = 100.0;

}  // namespace

Spine::Spine(const Wiring& wiring)
    : robot_(wiring.robot),
      constants_(wiring.constants),
      handover_(wiring.handover),
      inline_actuators_(wiring.inline_actuators),
      clock_(wiring.clock),
      grid_(std::llround(1e9 / wiring.robot.rate_hz), wiring.robot.spine.phase_ns),
      inbox_(wiring.spine, wiring.control, wiring.brain, wiring.supervised),
      out_(wiring.spine, static_cast<std::uint32_t>(wiring.robot.joints.size())),
      host_(clock_, wiring.barrier),
      step_(wiring.robot, wiring.slot, wiring.sandbox),
      sample_(&wiring.handover.latest_sample()),
      state_ticks_(static_cast<std::uint64_t>(std::max(1.0, std::round(wiring.robot.rate_hz / kStateHz)))) {
  hal::ActuatorCommand& first = handover_.next_command();
  first.joints = static_cast<std::uint32_t>(robot_.joints.size());
  first.act(hal::DriveAction::off);
  if (wiring.barrier == nullptr) return;
  for (const std::span<std::byte> block : step_.guarded())
    if (const Result<> guarded = wiring.barrier->guard(block.data(), block.size()); !guarded)
      std::fprintf(stderr, "lithe-spine: a law can reach the guard's limits: %s\n", guarded.message().c_str());
}

bool Spine::run(const std::atomic<bool>& stop) noexcept {
  grid_.start(clock_.now_ns());
  ReleaseWait wait(robot_.spine.release, grid_.period_ns());
  std::uint32_t skipped = 0;
  while (!stop.load(std::memory_order_relaxed)) {
    const std::int64_t woke_ns = wait.until(clock_.raw(), grid_.release_ns());
    tick(grid_.release_ns(), woke_ns, skipped);
    serve_inline();
    clock_.follow();
    skipped = grid_.advance(clock_.now_ns());
  }
  const bool all_off_sent = stop_drives();
  // A supervisor that adopted this process learns of its end only through this.
  out_.event(wire::EventKind::disarmed, clock_.now_ns(), all_off_sent ? 1 : 2, 0,
             all_off_sent ? "ended: every drive got the off command" : "ended: not every drive got the off command");
  return all_off_sent;
}

// Sends "off" to every drive twice, because the Transport may still be busy with the last command at the first one.
// True when all of it was sent.
bool Spine::stop_drives() noexcept {
  const std::uint32_t rounds = 2 * step::slowest_drive(robot_);
  const std::int64_t give_up_ns = clock_.now_ns() + 200 * kNsPerMs + rounds * grid_.period_ns();
  std::uint32_t sent = 0;
  while (sent < rounds && clock_.now_ns() < give_up_ns) {
    serve_inline();
    if (!handover_.idle()) {
      spin_pause();
      continue;
    }
    handover_.next_command().act(hal::DriveAction::off);
    handover_.next_command().joints = static_cast<std::uint32_t>(robot_.joints.size());
    handover_.dispatch();
    ++sent;
  }
  serve_inline();
  return sent == rounds;
}

}  // namespace lithe::loop
