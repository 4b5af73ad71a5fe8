// SPDX-License-Identifier: Apache-2.0
// The Spine maps memory that the Brain and the supervisor write. With any contents, every read must return.
#include <gtest/gtest.h>

#include <atomic>
#include <memory>
#include <random>
#include <thread>

#include "spine/ipc/layout.hpp"

namespace lithe::ipc {
namespace {

using Random = std::mt19937_64;

// The accesses of the Spine in a tick to the segments of other processes.
class SpineSide {
 public:
  SpineSide(const ControlMemory& control, const BrainMemory& brain, SpineMemory& spine)
      : plan_(brain.plan),
        brain_(brain.commands, spine.brain_ack),
        control_(control.commands, spine.control_ack),
        stage_(control.stage, spine.stage_ack) {}

  // The number of letters that one call took out. A letter is data and may have any contents; a ticket must be valid.
  int look() {
    int letters = 0;
    std::uint64_t ticket = 0;
    plans += plan_.read(plan) ? 1u : 0u;
    for (; letters < 100 && brain_.receive(command, ticket); ++letters) brain_.answer(ticket, 1);
    for (; letters < 100 && control_.receive(command, ticket); ++letters) control_.answer(ticket, 1);
    for (; letters < 100 && stage_.receive(stage, ticket); ++letters) stage_.answer(ticket, 1);
    return letters;
  }

  wire::Plan plan;
  wire::Command command;
  wire::StageRequest stage;
  std::uint64_t plans = 0;

 private:
  ChannelReader<wire::Plan> plan_;
  MailboxReceiver<wire::Command, wire::brain_segment::kCommandsDepth> brain_;
  MailboxReceiver<wire::Command, wire::control_segment::kCommandsDepth> control_;
  MailboxReceiver<wire::StageRequest, wire::control_segment::kStageDepth> stage_;
};

// Random words, with many small, huge and neighbouring numbers among them: these are critical for indices.
void scribble(void* memory, std::size_t bytes, Random& random) {
  auto* words = static_cast<std::uint64_t*>(memory);
  const std::uint64_t shape = random() % 4;
  for (std::size_t i = 0; i < bytes / 8; ++i) {
    const std::uint64_t raw = random();
    const std::uint64_t word = shape == 0   ? raw
                               : shape == 1 ? raw % 40
                               : shape == 2 ? ~(raw % 40)
                                            : raw << 63 | raw % 9;
    store_word(words[i], word, std::memory_order_relaxed);
  }
}

struct Segments {
  std::unique_ptr<ControlMemory> control = std::make_unique<ControlMemory>();
  std::unique_ptr<BrainMemory> brain = std::make_unique<BrainMemory>();
  std::unique_ptr<SpineMemory> spine = std::make_unique<SpineMemory>();
};

TEST(Hostile, GarbageNeverCrashesOrHangsTheSpine) {
  Segments segments;
  SpineSide side(*segments.control, *segments.brain, *segments.spine);
  Random random(1);
  for (int round = 0; round < 2000; ++round) {
    scribble(segments.control.get(), sizeof(ControlMemory), random);
    scribble(segments.brain.get(), sizeof(BrainMemory), random);
    for (int tick = 0; tick < 4; ++tick) ASSERT_LE(side.look(), 24) << "more letters than the mailboxes hold";
  }
}

TEST(Hostile, HonestBrainIsHeardAfterGarbage) {
  Random random(2);
  for (int round = 0; round < 200; ++round) {
    Segments segments;
    SpineSide side(*segments.control, *segments.brain, *segments.spine);
    for (int i = 0; i < 3; ++i) {
      scribble(segments.brain.get(), sizeof(BrainMemory), random);
      side.look();
    }
    wire::Plan plan;
    ChannelWriter<wire::Plan> writer(segments.brain->plan);
    MailboxSender<wire::Command, wire::brain_segment::kCommandsDepth> sender(segments.brain->commands,
                                                                             segments.spine->brain_ack);
    bool planned = false;
    bool commanded = false;
    for (std::uint64_t i = 0; i < 400 && !(planned && commanded); ++i) {
      plan.plan_id = (std::uint64_t{77} << 32) + i;
      writer.write(plan);
      const auto ticket = sender.send({});
      side.look();
      planned = planned || side.plan.plan_id == plan.plan_id;
      commanded = commanded || (ticket && sender.poll(*ticket) == 1);
    }
    ASSERT_TRUE(planned) << "round " << round;
    ASSERT_TRUE(commanded) << "round " << round;
  }
}

TEST(Hostile, ScribblingWhileTheSpineReadsIsHarmless) {
  Segments segments;
  SpineSide side(*segments.control, *segments.brain, *segments.spine);
  std::atomic<bool> stop{false};
  std::thread scribbler([&] {
    Random random(3);
    while (!stop.load()) {
      scribble(&segments.brain->plan.latest, 8, random);
      scribble(&segments.brain->plan.slots[random() % 4], 8 * 16, random);
      scribble(&segments.brain->commands.head, 8, random);
      scribble(&segments.brain->commands.slots, sizeof(segments.brain->commands.slots), random);
      scribble(&segments.control->stage, sizeof(segments.control->stage), random);
    }
  });
  for (int tick = 0; tick < 20'000; ++tick) {
    if (side.look() >= 100) {
      ADD_FAILURE() << "the mailbox never became empty";
      break;
    }
  }
  stop = true;
  scribbler.join();
}

}  // namespace
}  // namespace lithe::ipc
