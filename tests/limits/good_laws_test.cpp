// SPDX-License-Identifier: Apache-2.0
// What the guard with a model costs a good law: tracking error, and time in each tick.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <random>
#include <string>
#include <vector>

#include "spine/mechanics/tree.hpp"
#include "spine/robot/limits/model.hpp"
#include "spine/robot/robot.hpp"
#include "tests/limits/rig.hpp"

namespace lithe::limits {
namespace {

robot::RobotConfig chain() {
  Result<robot::RobotConfig> robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/chain.toml");
  EXPECT_TRUE(robot) << robot.message();
  robot->guard.soft_start_s = 0;
  return *robot;
}

// A sine of each joint, all with speeds and torques inside the robot's limits.
class Reference {
 public:
  static constexpr double kSeconds = 2;

  // `pace`: share of the fastest motion on this path that keeps 0.9 of velocity_max and 0.8 of torque_max.
  Reference(const robot::RobotConfig& robot, std::uint64_t seed, double pace) : joints_(robot.joints.size()) {
    std::mt19937_64 random(seed);
    const auto between = [&](double low, double high) {
      return std::uniform_real_distribution<double>(low, high)(random);
    };
    for (std::size_t j = 0; j < joints_; ++j) {
      const double most = 0.5 * (robot.joints[j].position_max_rad - robot.joints[j].position_min_rad) - 0.1;
      amplitude_rad_[j] = most * between(0.3, 0.9);
      center_rad_[j] = (most - amplitude_rad_[j]) * between(-1, 1);
      turn_rad_s_[j] = between(0.5, 1.0);
      phase_rad_[j] = between(0, 6.28);
    }
    double slow = 0.1, fast = 50;
    for (int i = 0; i < 30; ++i) {
      time_scale_ = 0.5 * (slow + fast);
      (within(robot) ? slow : fast) = time_scale_;
    }
    time_scale_ = pace * slow;
  }

  void at(double t, JointArray& q, JointArray& v, JointArray& a) const {
    for (std::size_t j = 0; j < joints_; ++j) {
      const double w = time_scale_ * turn_rad_s_[j], angle = w * t + phase_rad_[j];
      q[j] = center_rad_[j] + amplitude_rad_[j] * std::sin(angle);
      v[j] = amplitude_rad_[j] * w * std::cos(angle);
      a[j] = -amplitude_rad_[j] * w * w * std::sin(angle);
    }
  }

 private:
  bool within(const robot::RobotConfig& robot) const {
    mechanics::Tree tree = robot::tree_of(robot);
    for (int i = 0; i < 100 * kSeconds; ++i) {
      JointArray q{}, v{}, a{}, nm{};
      at(0.01 * i, q, v, a);
      tree.pose(q);
      tree.torque(v, a, nm);
      for (std::size_t j = 0; j < joints_; ++j)
        if (std::abs(v[j]) > 0.9 * robot.joints[j].velocity_max_rad_s ||
            std::abs(nm[j]) > 0.8 * robot.joints[j].torque_max_nm)
          return false;
    }
    return true;
  }

  std::size_t joints_;
  JointArray amplitude_rad_{}, center_rad_{}, turn_rad_s_{}, phase_rad_{};
  double time_scale_ = 1;
};

enum class Good { gravity_pd, impedance, computed_torque };
constexpr std::array kGood{Good::gravity_pd, Good::impedance, Good::computed_torque};
constexpr std::array kNames{"gravity_pd", "impedance", "computed_torque"};

struct Tracked {
  double error_rad = 0, changed = 0;  // root of the mean square, without the first quarter; share of ticks
};

Tracked track(const robot::RobotConfig& robot, Good which, std::uint64_t seed, double pace, bool guarded) {
  const Reference reference(robot, seed, pace);
  mechanics::Tree tree = robot::tree_of(robot);
  const std::size_t joints = robot.joints.size();
  JointArray q0{}, v0{}, a0{};
  reference.at(0, q0, v0, a0);
  Run run;
  run.robot = robot;
  run.seconds = Reference::kSeconds;
  run.unguarded = !guarded;
  for (std::size_t j = 0; j < joints; ++j) run.robot.joints[j].sim.initial_position_rad = q0[j];
  run.law = [&](double t, const JointArray& q, const JointArray& v, Effort& out) {
    JointArray want{}, speed{}, a{}, nm{};
    reference.at(t, want, speed, a);
    tree.pose(q);
    if (which == Good::computed_torque) {
      constexpr double kBandwidthRadS = 40;
      for (std::size_t j = 0; j < joints; ++j)
        a[j] += kBandwidthRadS * kBandwidthRadS * (want[j] - q[j]) + 2 * kBandwidthRadS * (speed[j] - v[j]);
      tree.torque(v, a, nm);
    } else {
      tree.torque({}, {}, nm);  // gravity
    }
    for (std::size_t j = 0; j < joints; ++j) {
      const double kp = 40 - 12 * static_cast<double>(j), kd = 1.2 - 0.5 * static_cast<double>(j);
      out.torque_nm[j] = nm[j];
      out.position_rad[j] = kNoTarget;
      if (which == Good::gravity_pd) out.torque_nm[j] += kp * (want[j] - q[j]) + kd * (speed[j] - v[j]);
      if (which != Good::impedance) continue;
      out.position_rad[j] = want[j];
      out.velocity_rad_s[j] = speed[j];
      out.kp_nm_rad[j] = kp;
      out.kd_nm_s_rad[j] = kd;
    }
  };
  double sum = 0;
  std::uint64_t count = 0;
  run.watch = [&](double t, const JointArray& q) {
    if (t < 0.25 * Reference::kSeconds) return;
    JointArray want{}, speed{}, a{};
    reference.at(t, want, speed, a);
    for (std::size_t j = 0; j < joints; ++j) sum += (q[j] - want[j]) * (q[j] - want[j]);
    count += joints;
  };
  const Extremes extremes = play(run);
  return {std::sqrt(sum / static_cast<double>(count)),
          static_cast<double>(extremes.changed) / static_cast<double>(extremes.ticks)};
}

struct Share {
  double error = 0, worst = 0, changed = 0;  // error guarded over unguarded: of all references, of one; of ticks
};
constexpr std::uint64_t kReferences = 20;
constexpr double kPace = 0.6;

Share share_of(const robot::RobotConfig& robot, Good which, double pace) {
  Share share;
  double on = 0, off = 0;
  for (std::uint64_t seed = 101; seed <= 100 + kReferences; ++seed) {
    const Tracked with = track(robot, which, seed, pace, true), without = track(robot, which, seed, pace, false);
    on += with.error_rad * with.error_rad;
    off += without.error_rad * without.error_rad;
    share.worst = std::max(share.worst, with.error_rad / without.error_rad);
    share.changed += with.changed / kReferences;
  }
  share.error = std::sqrt(on / off);
  return share;
}

void tell(const char* name, double pace, const Share& share) {
  std::printf("%-16s at %.1f of the fastest pace: error %.3f of that without a guard, at most %.3f; %.3f of ticks\n",
              name, pace, share.error, share.worst, share.changed);
}

TEST(LimitsGood, LawsAtSixTenthsOfTheFastestPaceAreNotHindered) {
  const robot::RobotConfig robot = chain();
  for (std::size_t i = 0; i < kGood.size(); ++i) {
    const Share share = share_of(robot, kGood[i], kPace);
    tell(kNames[i], kPace, share);
    EXPECT_LE(share.error, 1.05) << kNames[i];
  }
}

TEST(LimitsGoodTwin, AGuardThatDoesNotTrustItsModelHindersThem) {
  robot::RobotConfig robot = chain();
  robot.model.error = 2;
  EXPECT_GT(share_of(robot, Good::gravity_pd, kPace).error, 1.05);
}

// For docs/adr/0026.
TEST(LimitsGood, DISABLED_LawsAtEveryPace) {
  const robot::RobotConfig with = chain();
  robot::RobotConfig without = with;
  without.model.given = false;
  for (const double pace : {0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0})
    for (std::size_t i = 0; i < kGood.size(); ++i) {
      tell(kNames[i], pace, share_of(with, kGood[i], pace));
      std::printf("  without a model ");
      tell(kNames[i], pace, share_of(without, kGood[i], pace));
    }
}

// Links of 0.12 m in one plane.
robot::RobotConfig long_chain(int joints) {
  std::string text =
      "name = \"r\"\nrate_hz = 1000\n[plant]\nkind = \"chain\"\n[model]\ngravity_m_s2 = [0, -9.81, 0]\n"
      "[defaults.device]\nkind = \"moteus\"\nbus = \"b\"\n[[bus]]\nname = \"b\"\nkind = \"loop\"\n";
  for (int j = 0; j < joints; ++j) {
    const std::string name = "j" + std::to_string(j);
    text += "[[device]]\nname = \"" + name + "_drive\"\nid = " + std::to_string(j + 1) + "\n[[joint]]\nname = \"" +
            name + "\"\ndevice = \"" + name +
            "_drive\"\nratio = 6\nposition_min_rad = -2.5\nposition_max_rad = 2.5\nvelocity_max_rad_s = 15\n"
            "torque_max_nm = 6\ntorque_slew_nm_s = 1200\nload_max_nm = 3\ninertia_max_kg_m2 = 0.075\n"
            "inertia_min_kg_m2 = 0.019\nkd_max_nm_s_rad = 4\nsafe_kd_nm_s_rad = 0.3\n[joint.model]\noffset_m = [0, " +
            (j == 0 ? "0" : "-0.12") +
            ", 0]\nmass_kg = 0.04\ncenter_m = [0, -0.06, 0]\ninertia_kg_m2 = [1.2e-4, 0, 1.2e-4, 0, 0, 0]\n"
            "rotor_inertia_kg_m2 = 2e-3\n[joint.sim]\nlength_m = 0.12\nmass_kg = 0.04\nrotor_inertia_kg_m2 = 2e-3\n";
  }
  Result<robot::RobotConfig> robot = robot::parse_robot(text, "r.toml");
  EXPECT_TRUE(robot) << robot.message();
  return *robot;
}

double us_at(std::vector<std::int64_t> ns, double share) {
  std::sort(ns.begin(), ns.end());
  return 1e-3 * static_cast<double>(ns[static_cast<std::size_t>(share * static_cast<double>(ns.size() - 1))]);
}

// For docs/adr/0026: of the guard alone, on this core as it is.
TEST(LimitsCost, DISABLED_OfTheGuardInATick) {
  constexpr int kFirstTicks = 50;  // fetch memory that a Spine has fetched and locked before
  for (const int joints : {3, 6, 7, 12}) {
    std::array<std::vector<std::int64_t>, 4> took_ns;  // without a model, with one; each at rest, then against a law
    const robot::RobotConfig robot = long_chain(joints);
    for (std::uint64_t seed = 1; seed <= 20; ++seed)
      for (std::size_t i = 0; i < took_ns.size(); ++i) {
        limits::Run run;
        run.robot = robot;
        run.robot.model.given = i % 2 == 1;
        run.adversary = Adversary::random_hold;
        run.seed = seed;
        run.seconds = 0.5;
        if (i < 2) run.law = [](double, const JointArray&, const JointArray&, Effort&) {};
        std::vector<std::int64_t> each_ns;
        run.check_ns = &each_ns;
        play(run);
        took_ns[i].insert(took_ns[i].end(), each_ns.begin() + kFirstTicks, each_ns.end());
      }
    std::printf("%2d joints", joints);
    for (std::size_t i = 0; i < took_ns.size(); ++i)
      std::printf("; %s, %s: p50 %.2f p99.9 %.2f us", i % 2 == 1 ? "model" : "none", i < 2 ? "limp" : "hostile",
                  us_at(took_ns[i], 0.5), us_at(took_ns[i], 0.999));
    std::printf("\n");
  }
}

}  // namespace
}  // namespace lithe::limits
