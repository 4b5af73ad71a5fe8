// SPDX-License-Identifier: Apache-2.0
// Shared memory that another process writes: any words at any place, between the looks that the Spine takes.
#include <cmath>
#include <memory>

#include "spine/ipc/layout.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/plan/check.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

using namespace ipc;
constexpr std::size_t kBrainDepth = wire::brain_segment::kCommandsDepth;
constexpr std::size_t kControlDepth = wire::control_segment::kCommandsDepth;
constexpr std::size_t kStageDepth = wire::control_segment::kStageDepth;
constexpr int kMostPokes = 512;

// What the Spine does in a tick with the segments of others.
class SpineSide {
 public:
  SpineSide(const ControlMemory& control, const BrainMemory& brain, SpineMemory& spine)
      : plan_(brain.plan),
        brain_(brain.commands, spine.brain_ack),
        control_(control.commands, spine.control_ack),
        stage_(control.stage, spine.stage_ack) {
    limits_.joints = 2;
    for (std::size_t i = 0; i < limits_.joints; ++i) {
      limits_.joint[i].position_min_rad = -2;
      limits_.joint[i].position_max_rad = 2;
      limits_.joint[i].velocity_max_rad_s = 10;
    }
  }

  void look() {
    std::uint64_t ticket = 0;
    if (plan_.read(plan)) follow();
    drain(brain_, command, kBrainDepth, ticket);
    drain(control_, command, kControlDepth, ticket);
    drain(stage_, stage, kStageDepth, ticket);
  }

 private:
  template <class Box, class CommandTicket>
  static void drain(Box& box, CommandTicket& letter, std::size_t depth, std::uint64_t& ticket) {
    std::size_t letters = 0;
    while (box.receive(letter, ticket)) {
      require(++letters <= depth, "no more letters than a mailbox holds");
      box.answer(ticket, 1);
    }
  }

  // A plan that passes is one that can be followed.
  void follow() {
    const wire::PlanDecision verdict = plan::check(plan, limits_, 5'000'000'000);
    if (plan::reason_of(verdict) != wire::PlanReject::none) return;
    require(plan.waypoint_count >= 1 && plan.waypoint_count <= wire::kNw && plan.joint_count == limits_.joints,
            "a plan that passes is of this robot");
    for (std::size_t point = 0; point < plan.waypoint_count; ++point) {
      require(point == 0 || plan.t_ns[point] > plan.t_ns[point - 1], "a plan that passes goes forward");
      for (std::size_t joint = 0; joint < limits_.joints; ++joint) {
        const double position_rad = plan.position_rad[point * kMaxJoints + joint];
        require(std::abs(position_rad) <= 2 + 1e-8, "a plan that passes stays within the limits");
      }
    }
  }

  wire::Plan plan;
  wire::Command command;
  wire::StageRequest stage;
  plan::Limits limits_;
  ChannelReader<wire::Plan> plan_;
  MailboxReceiver<wire::Command, kBrainDepth> brain_;
  MailboxReceiver<wire::Command, kControlDepth> control_;
  MailboxReceiver<wire::StageRequest, kStageDepth> stage_;
};

void poke(void* memory, std::size_t bytes, Input& input) {
  const std::size_t at = input.number<std::uint16_t>() % (bytes / 8);
  const std::uint8_t kind = input.byte();
  const std::uint64_t word = kind < 128 ? input.number<std::uint64_t>() : kind % 16 - 4ULL;
  store_word(static_cast<std::uint64_t*>(memory)[at], word, std::memory_order_relaxed);
}

// A plan as a Brain writes it, with what the bytes make of it.
void write_plan(BrainMemory& brain, Input& input) {
  wire::Plan plan;
  plan.plan_id = input.byte();
  plan.waypoint_count = input.byte() % 20;
  plan.joint_count = 2;
  for (std::size_t point = 0; point < wire::kNw; ++point) {
    plan.t_ns[point] = 5'000'000'000 + static_cast<std::int64_t>(point + 1) * 1'000'000 * input.byte();
    for (std::size_t joint = 0; joint < 2; ++joint) {
      plan.position_rad[point * kMaxJoints + joint] = input.real();
      plan.velocity_rad_s[point * kMaxJoints + joint] = input.real();
    }
  }
  ChannelWriter<wire::Plan>(brain.plan).write(plan);
}

}  // namespace

void run(Bytes bytes) {
  static const auto control = std::make_unique<ControlMemory>();
  static const auto brain = std::make_unique<BrainMemory>();
  static const auto spine = std::make_unique<SpineMemory>();
  std::memset(static_cast<void*>(control.get()), 0, sizeof(ControlMemory));
  std::memset(static_cast<void*>(brain.get()), 0, sizeof(BrainMemory));
  SpineSide side(*control, *brain, *spine);
  Input input(bytes);
  const std::string_view theirs = input.text(input.byte());
  require(schema_difference(theirs, theirs).empty(), "a layout does not differ from itself");
  schema_difference(wire::kCanonicalSchema, theirs);
  for (int i = 0; i < kMostPokes && !input.empty(); ++i) {
    const std::uint8_t what = input.byte();
    if (what % 8 == 0) side.look();
    if (what % 8 == 1) write_plan(*brain, input);
    if (what % 8 == 2) MailboxSender<wire::Command, kBrainDepth>(brain->commands, spine->brain_ack).send({});
    if (what % 8 == 3 || what % 8 == 4) poke(&brain->plan, sizeof(brain->plan), input);
    if (what % 8 == 5) poke(&brain->commands, sizeof(brain->commands), input);
    if (what % 8 == 6) poke(control.get(), sizeof(ControlMemory), input);
    if (what % 8 == 7) poke(brain.get(), sizeof(BrainMemory), input);
  }
  side.look();
}

std::vector<Seed> seeds() {
  Script good, bad, outside, heads;
  for (Script* script : {&good, &bad, &outside, &heads}) script->byte(20).text("Plan.plan_id:uint64:");
  for (int round = 0; round < 4; ++round) {
    for (Script* script : {&good, &bad, &outside}) {
      script->byte(1).byte(7).byte(16).byte(0);
      for (int point = 0; point < 16; ++point) {
        script->byte(100);
        const double position =
            script == &good ? 0.01 * point : (script == &bad ? kSharp[static_cast<std::size_t>(point)] : 2.5);
        script->real(position).real(kSharp[4]).real(position).real(kSharp[4]);
      }
      script->byte(0).byte(2).byte(2).byte(0);
    }
  }
  for (unsigned i = 0; i < 60; ++i)
    heads.byte(3 + i % 5).number(static_cast<std::uint16_t>(i * 8)).byte(128 + i).byte(0).byte(2);
  return {good, bad, outside, heads};
}

}  // namespace lithe::fuzz
