// SPDX-License-Identifier: Apache-2.0
// From wherever verbs and bad laws can bring a robot with healthy drives, verbs alone bring it back to its law.
#include <gtest/gtest.h>

#include <random>
#include <string>

#include "spine/loop/test/recover_rig.hpp"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define LITHE_SLOW 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || __has_feature(realtime_sanitizer)
#define LITHE_SLOW 1
#endif
#endif

namespace lithe::loop {
namespace {

#ifdef LITHE_SLOW
constexpr int kRobots = 4;
#else
constexpr int kRobots = 40;
#endif
constexpr int kSequences = 25;  // of each robot, one after another

using Random = std::mt19937_64;

double between(Random& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

robot::RobotConfig random_robot(Random& random) {
  const JointText kinds[] = {{-3, 3, between(random, -4.5, 4.5)},   // a full turn, and beyond
                             {1, 2, between(random, -0.5, 2.5)},    // hangs below its range
                             {-0.4, 0.4, between(random, -2, 2)}};  // narrow
  return robot_of(250, {kinds[random() % std::size(kinds)]});
}

class Rig : public RecoverBench {
 public:
  using RecoverBench::RecoverBench;

  // One verb, law or plan, and some time.
  void anything(Random& random) {
    constexpr CommandKind verbs[] = {CommandKind::arm,      CommandKind::disarm, CommandKind::hold,
                                     CommandKind::reset,    CommandKind::estop,  CommandKind::recover,
                                     CommandKind::rollback, CommandKind::arm};
    constexpr const LitheLaw* laws[] = {&kPdAll, &kPush, &kPushUp, &kNotFinite};
    switch (random() % 6) {
      case 0:
        stage(*laws[random() % std::size(laws)]);
        break;
      case 1:
        publish(between(random, robot_.joints[0].position_min_rad, robot_.joints[0].position_max_rad));
        break;
      case 2:
        control_memory_->estop.value = random() % 4 == 0 ? 1 : 0;
        break;
      default:
        send(verbs[random() % std::size(verbs)]);
    }
    ticks(1 + static_cast<int>(random() % 40));
  }

  // What a person does who wants the robot to run: the e-stop is lifted, a good law is there.
  bool come_back(bool may_recover) {
    control_memory_->estop.value = 0;
    stage(kPdAll);
    ticks(3);
    send(CommandKind::reset);
    send(CommandKind::disarm);
    ticks(5);
    if (arm_and_stay()) return true;
    if (!may_recover) {  // all there was
      send(CommandKind::disarm);
      send(CommandKind::reset);
      ticks(5);
      return arm_and_stay();
    }
    for (int attempt = 0; attempt < 3; ++attempt) {  // what swings may exceed the velocity that is a fault
      if (send(CommandKind::recover) == CommandResult::done && finish_recovery(40) && arm_and_stay()) return true;
      if (mode() == Mode::safe_stop) ticks(100);
    }
    return false;
  }

  std::string where() const {
    return fmt::format("mode {}, fault {}, at {:.3f} rad of [{}, {}]", wire::to_string(mode()),
                       wire::to_string(fault()), record_.position_rad[0], robot_.joints[0].position_min_rad,
                       robot_.joints[0].position_max_rad);
  }

 private:
  bool arm_and_stay() {
    if (send(CommandKind::arm) != CommandResult::done) return false;
    ticks(50);
    return mode() == Mode::active;
  }
};

int sequences_without_return(int robots, bool may_recover, std::string& first) {
  int lost = 0;
  for (int robot = 0; robot < robots; ++robot) {
    Random random(static_cast<std::uint64_t>(robot));
    Rig rig(random_robot(random));
    rig.ticks(10);
    for (int sequence = 0; sequence < kSequences; ++sequence) {
      for (std::uint64_t i = 2 + random() % 12; i > 0; --i) rig.anything(random);
      if (rig.come_back(may_recover)) continue;
      if (lost++ == 0) first = fmt::format("robot {}, sequence {}: {}", robot, sequence, rig.where());
    }
  }
  return lost;
}

TEST(WayBack, VerbsAloneLeadBackToActiveFromWhereverVerbsAndLawsCanLead) {
  std::string first;
  EXPECT_EQ(sequences_without_return(kRobots, true, first), 0) << first;
}

// The same sequences, without the verb.
TEST(WayBack, WithoutRecoverManyRobotsStayOutside) {
  std::string first;
  EXPECT_GT(sequences_without_return(4, false, first), 4 * kSequences / 10) << first;
}

}  // namespace
}  // namespace lithe::loop
