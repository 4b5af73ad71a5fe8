// SPDX-License-Identifier: Apache-2.0
// Computes a continuous setpoint for every tick from a plan's waypoints.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/plan/blend.hpp"
#include "spine/plan/check.hpp"
#include "spine/plan/knots.hpp"
#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::plan {

struct Setpoint {
  JointArray position_rad{};
  JointArray velocity_rad_s{};
  JointArray acceleration_rad_s2{};
  // The way of the steps of held plans, which fades in about kStepFadesS, by at most half of the velocity limit: so far
  // a joint may be from the setpoint without blame for its law. And the mean speed of the steps of the last kStepS.
  JointArray stepped_rad{}, step_rad_s{};
  bool steps = false;  // since the sample before
  wire::PlanState state = wire::PlanState::none;
};

// But for held plans, position and velocity are continuous through everything: knots, a new plan in flight, the end of
// a plan. And the setpoint never moves faster than velocity_max_rad_s: a plan whose own curve does is refused. So is
// one whose first waypoint ahead is further from the present setpoint than that allows, unless it is a stream with
// three or more waypoints ahead, which may catch up.
//   track  a cubic per segment through the waypoints (knots.hpp); velocities the plan gives are used exactly.
//   coast  the plan ran out while moving: each joint slows down by its deceleration, harder only where its limit is
//          near.
//   hold   everything has come to rest.
// A new plan takes over at once. If it starts more than 50 ms ahead, one cubic leads from the present motion to its
// first waypoint; otherwise the difference of the two motions decays over 50 ms, or longer (up to 500 ms) when it is
// large. A joint for which 500 ms are too short (the Brain's stream went on while the robot was disarmed, or the stream
// itself paused) catches up instead (blend.hpp): it accelerates by at most deceleration_rad_s2, or twice the plan's
// own hardest acceleration where that is more, until what is left can be blended. The same holds for such a stream that
// starts ahead, when the cubic to its first waypoint would be harder or faster than that.
// Afterwards the setpoint is the plan's, exactly.
//
// A held plan (zero-order hold) takes over at once, too. At the time of each waypoint the setpoint steps to it, with
// the velocity that the plan gives, else 0, and stays there. Until its first waypoint a held setpoint stays, and a
// curve slows down as where a plan runs out. While the waypoint that holds is younger than stale_ns the state is track,
// then hold, with velocity 0. For a curve that follows, a held setpoint is at rest.
//
// Contract: RT after configure() · owned by the tick thread · bounded: at most one segment's coefficients per tick, and
// one look at the whole curve per joint that catches up
class Interpolator {
 public:
  void configure(const robot::RobotConfig& robot);

  // Follows `plan` from now on; or returns the reason and continues as before. The plan is copied.
  wire::PlanDecision accept(const wire::Plan& plan, std::int64_t now_ns) LITHE_RT;

  // The setpoint for `now_ns`, which never goes back between calls; and that of the last call.
  const Setpoint& sample(std::int64_t now_ns) LITHE_RT;
  const Setpoint& setpoint() const LITHE_RT { return setpoint_; }

  // Stand still at `position_rad`, clamped to the limits, from now on. A joint given NaN stays where it was.
  void hold_at(const JointArray& position_rad) LITHE_RT;

  // Drops the plan: coasts to rest from the present motion, then holds.
  void stop(std::int64_t now_ns) LITHE_RT;

  std::uint64_t plan_id() const LITHE_RT { return plan_id_; }  // of the plan last accepted; 0 = none yet

  // Since the time of the waypoint that holds, also where its plan came later; -1: the setpoint is not held.
  std::int64_t held_for_ns(std::int64_t now_ns) const LITHE_RT {
    return held_ == Held::on ? now_ns - piece_.since_ns : -1;
  }

  static constexpr double kStepFadesS = 0.5;  // a good law is at the setpoint by then
  static constexpr double kStepS = 0.05;      // it may follow a step as fast as this

 private:
  enum class Held : std::uint8_t { no, ahead, on };  // ahead: its first waypoint is still to come

  // What each joint follows from since_ns on, standing still after last_s.
  struct Piece {
    std::int64_t since_ns = 0;
    std::array<Arc, kMaxJoints> arc{};
    JointArray last_s{};
  };
  // The rest of the blend from the motion before a new plan.
  struct Blend {
    std::array<std::int64_t, kMaxJoints> since_ns{};
    std::int64_t until_ns = 0;
    std::array<Decay, kMaxJoints> joint{};

    void add(std::size_t j, std::int64_t now_ns, const Decay& decay) LITHE_RT;
  };

  void evaluate(std::int64_t now_ns, Setpoint& out) const LITHE_RT;
  // For joints that catch up: the motion they catch up with.
  void follow_curve(std::int64_t now_ns, Setpoint& out) const LITHE_RT;
  void keep_inside(Setpoint& out) const LITHE_RT;
  void advance(std::int64_t now_ns) LITHE_RT;
  void hold_plan(const wire::Plan& plan, std::int64_t now_ns) LITHE_RT;
  void advance_held(std::int64_t now_ns) LITHE_RT;
  void step_to(std::size_t knot, std::int64_t now_ns) LITHE_RT;
  void fade_steps(std::int64_t now_ns) LITHE_RT;
  void lead_to_first() LITHE_RT;
  void enter_segment(std::size_t knot) LITHE_RT;
  void enter_coast(std::int64_t from_ns, const JointArray& position, const JointArray& velocity) LITHE_RT;
  double slowing(std::size_t j, double position_rad, double velocity_rad_s) const LITHE_RT;
  wire::PlanDecision check_way_to(const wire::Plan& plan, std::uint32_t waypoint, std::int64_t now_ns,
                                  const Setpoint& from) const LITHE_RT;
  wire::PlanDecision too_fast(std::int64_t now_ns, std::size_t j, double most_rad_s, bool leads) const LITHE_RT;
  void lay_knots(const wire::Plan& plan, std::int64_t now_ns, const Setpoint* from) LITHE_RT;
  bool lead_is_harsh(const JointArray& most_rad_s) const LITHE_RT;
  double most_rad_s2(const Knots& knots, std::size_t first, std::size_t j) const LITHE_RT;
  // The gentlest way of each joint from the present motion onto `next`: a blend, or catching up. What stays below
  // `bound_rad_s` without any blend needs no closer look.
  void join(const Knots& next, std::int64_t now_ns, const Setpoint& from, const JointArray& bound_rad_s,
            const JointArray& most_rad_s) LITHE_RT;
  void stop_catching_up() LITHE_RT;
  void catch_up(std::int64_t now_ns) LITHE_RT;
  bool blend_the_rest(std::size_t j, std::int64_t now_ns, double gap_rad, double gap_rad_s, double curve_rad_s)
      LITHE_RT;
  const Knots& knots() const LITHE_RT { return knots_[used_]; }

  Limits limits_;
  JointArray deceleration_rad_s2_{};
  std::array<bool, kMaxJoints> monotone_{};

  std::array<Knots, 2> knots_{};  // the ones in use, and where the next plan is tried
  std::size_t used_ = 0;
  std::size_t segment_ = 0;  // of a held plan: its next waypoint
  std::uint64_t plan_id_ = 0;

  wire::PlanState state_ = wire::PlanState::none;
  std::int64_t coast_until_ns_ = 0;
  Piece piece_;
  Blend blend_;
  std::array<CatchUp, kMaxJoints> catch_up_{};
  bool catching_up_ = false;  // one of them
  std::int64_t caught_up_to_ns_ = 0;
  Held held_ = Held::no;
  JointArray held_rad_s_{};
  std::int64_t faded_to_ns_ = 0;
  bool stepped_ = false;  // since the last sample
  Setpoint setpoint_;
};

}  // namespace lithe::plan
