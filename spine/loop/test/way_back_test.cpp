// SPDX-License-Identifier: Apache-2.0
// From wherever verbs and bad laws can bring a robot with healthy drives, verbs alone bring it back to its law: robots
// of one to four joints, with drives of both kinds, at 250 Hz to 4 kHz.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <random>
#include <set>
#include <string>
#include <vector>

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
constexpr int kRobots = 6;
#else
constexpr int kRobots = 40;
#endif
constexpr int kSequences = 25;  // of one joint at 250 Hz, one after another; the others have fewer in the same time
constexpr std::size_t kMostJoints = 4;

using robot::DeviceKind;
using Random = std::mt19937_64;

double between(Random& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

JointText random_joint(Random& random) {
  const JointText kinds[] = {{-3, 3, between(random, -4.5, 4.5)},   // a full turn, and beyond
                             {1, 2, between(random, -0.5, 2.5)},    // hangs below its range
                             {-0.4, 0.4, between(random, -2, 2)}};  // narrow
  JointText joint = kinds[random() % std::size(kinds)];
  joint.drive = random() % 2 == 0 ? DeviceKind::moteus : DeviceKind::cia402;
  return joint;
}

robot::RobotConfig random_robot(Random& random) {
  constexpr double rates[] = {250, 250, 500, 1000, 2000, 4000};
  std::vector<JointText> joints(1 + random() % kMostJoints);
  for (JointText& joint : joints) joint = random_joint(random);
  return robot_of(rates[random() % std::size(rates)], joints);
}

// What was drawn, over all robots.
struct Drawn {
  std::set<std::size_t> joints;
  std::set<double> rates;
  int mixed = 0, cia402_only = 0, sequences = 0;
  void see(const robot::RobotConfig& robot) {
    joints.insert(robot.joints.size());
    rates.insert(robot.rate_hz);
    const auto others =
        std::ranges::count_if(robot.devices, [](const auto& each) { return each.kind == DeviceKind::cia402; });
    mixed += others > 0 && others < std::ssize(robot.devices) ? 1 : 0;
    cia402_only += others == std::ssize(robot.devices) ? 1 : 0;
  }
};

class Rig : public RecoverBench {
 public:
  explicit Rig(const robot::RobotConfig& robot) : RecoverBench(robot) {
    for (int left = ticks_in(10); left > 0 && !all_set_up(); --left) tick();
    EXPECT_TRUE(all_set_up());
  }

  // One verb, law or plan, and some time.
  void anything(Random& random) {
    constexpr CommandKind verbs[] = {CommandKind::arm,      CommandKind::disarm, CommandKind::hold,
                                     CommandKind::reset,    CommandKind::estop,  CommandKind::recover,
                                     CommandKind::rollback, CommandKind::arm};
    constexpr const LitheLaw* laws[] = {&kPdAll, &kPush, &kPushUp, &kNotFinite, &kWrongSign, &kShake, &kNotFiniteLate};
    switch (random() % 6) {
      case 0:
        stage(*laws[random() % std::size(laws)]);
        break;
      case 1:
        go_anywhere(random);
        break;
      case 2:
        control_memory_->estop.value = random() % 4 == 0 ? 1 : 0;
        break;
      default:
        send(verbs[random() % std::size(verbs)]);
    }
    ticks(1 + static_cast<int>(random() % static_cast<std::uint64_t>(ticks_in(0.16))));
  }

  // What a person does who wants the robot to run: the e-stop is lifted, a good law is there.
  bool come_back(bool may_recover) {
    control_memory_->estop.value = 0;
    stage(kPdAll);
    ticks(3);
    send_off(CommandKind::reset);
    send_off(CommandKind::disarm);
    ticks(ticks_in(0.02));
    if (arm_and_stay()) return true;
    if (!may_recover) {  // all there was
      send_off(CommandKind::disarm);
      send_off(CommandKind::reset);
      ticks(ticks_in(0.02));
      return arm_and_stay();
    }
    for (int attempt = 0; attempt < 3; ++attempt) {  // what swings may exceed the velocity that is a fault
      if (send(CommandKind::recover) == CommandResult::done && finish_recovery(40) && arm_and_stay()) return true;
      if (mode() == Mode::safe_stop) ticks(ticks_in(0.4));
    }
    return false;
  }

  std::string where() const {
    std::string words =
        fmt::format("{} Hz, mode {}, fault {}", robot_.rate_hz, wire::to_string(mode()), wire::to_string(fault()));
    for (std::size_t j = 0; j < robot_.joints.size(); ++j) {
      const robot::JointConfig& joint = robot_.joints[j];
      words += fmt::format("; {} ({}): {}, status {:#x}, {:.3f} rad of [{}, {}], {:.2f} rad/s", joint.name,
                           robot::word(robot_.devices[joint.device].kind),
                           wire::to_string(static_cast<wire::Fault>(record_.joint_fault[j])), record_.joint_status[j],
                           record_.position_rad[j], joint.position_min_rad, joint.position_max_rad,
                           record_.velocity_rad_s[j]);
    }
    return words;
  }

 private:
  bool all_set_up() const {
    return record_.tick > 0 &&
           std::all_of(record_.joint_status.begin(), record_.joint_status.begin() + std::ssize(robot_.joints),
                       [](std::uint32_t status) {
                         return (status & wire::joint_status::kFresh) != 0 &&
                                (status & wire::joint_status::kNotReady) == 0;
                       });
  }

  void go_anywhere(Random& random) {
    wire::Plan plan;
    plan.plan_id = ++plan_id_;
    plan.waypoint_count = 1;
    plan.joint_count = static_cast<std::uint32_t>(robot_.joints.size());
    plan.t_ns[0] = now_ns_ + 300 * kNsPerMs;
    for (std::size_t j = 0; j < robot_.joints.size(); ++j) {
      plan.position_rad[j] = between(random, robot_.joints[j].position_min_rad, robot_.joints[j].position_max_rad);
      plan.velocity_rad_s[j] = std::numeric_limits<double>::quiet_NaN();
    }
    ipc::ChannelWriter<wire::Plan>(brain_memory_->plan).write(plan);
    brain_memory_->header.heartbeat_ns = now_ns_;
  }

  // As the supervisor does it: while a sample is late, it asks again for a while.
  bool arm_and_stay() {
    CommandResult result = arm_all_the_same();
    for (int left = ticks_in(0.2); left > 0 && result == CommandResult::refused_not_ready; --left)
      result = arm_all_the_same();
    if (result != CommandResult::done) return false;
    ticks(ticks_in(0.2));
    return mode() == Mode::active;
  }
};

// As much of a slow machine's time for each robot.
int sequences_of(const robot::RobotConfig& robot) {
  const double work = static_cast<double>(robot.joints.size()) * (1 + robot.rate_hz / 1000);
  return std::max(2, static_cast<int>(kSequences / work));
}

int sequences_without_return(int robots, bool may_recover, Drawn& drawn, std::string& first) {
  int lost = 0;
  for (int robot = 0; robot < robots; ++robot) {
    Random random(static_cast<std::uint64_t>(robot));
    const robot::RobotConfig config = random_robot(random);
    drawn.see(config);
    Rig rig(config);
    rig.ticks(10);
    for (int sequence = 0; sequence < sequences_of(config); ++sequence) {
      ++drawn.sequences;
      for (std::uint64_t i = 2 + random() % 12; i > 0; --i) rig.anything(random);
      if (rig.come_back(may_recover)) continue;
      if (lost++ == 0) first = fmt::format("robot {}, sequence {}: {}", robot, sequence, rig.where());
    }
  }
  return lost;
}

TEST(WayBack, VerbsAloneLeadBackToActiveFromWhereverVerbsAndLawsCanLead) {
  std::string first;
  Drawn drawn;
  EXPECT_EQ(sequences_without_return(kRobots, true, drawn, first), 0) << first;
  std::printf(
      "%d sequences on %d robots, of 1 to %zu joints at %g to %g Hz, %d of them with drives of both kinds, %d "
      "with CiA 402 only\n",
      drawn.sequences, kRobots, *drawn.joints.rbegin(), *drawn.rates.begin(), *drawn.rates.rbegin(), drawn.mixed,
      drawn.cia402_only);
  EXPECT_GT(drawn.mixed, 0);
#ifndef LITHE_SLOW
  EXPECT_EQ(drawn.joints.size(), kMostJoints);
  EXPECT_EQ(drawn.rates.size(), 5u);
  EXPECT_GT(drawn.cia402_only, 0);
#endif
}

// The long form; only `make check-all` runs it.
TEST(WayBack, DISABLED_TwoThousandSequences) {
  std::string first;
  Drawn drawn;
  EXPECT_EQ(sequences_without_return(300, true, drawn, first), 0) << first;
  EXPECT_GE(drawn.sequences, 2000);
}

// The same sequences, without the verb.
TEST(WayBack, WithoutRecoverManyRobotsStayOutside) {
  std::string first;
  Drawn drawn;
  const int lost = sequences_without_return(4, false, drawn, first);
  EXPECT_GT(lost, drawn.sequences / 10) << first;
}

}  // namespace
}  // namespace lithe::loop
