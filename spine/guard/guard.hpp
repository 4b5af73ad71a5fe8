// SPDX-License-Identifier: Apache-2.0
// The only code between a law and the motors. It trusts no law, no Brain and no sensor.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/guard/safe_law.hpp"
#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::guard {

// What the law asks for. Position NaN = no drive-side PD on position.
struct Proposal {
  const JointArray& torque_nm;
  const JointArray& position_rad;
  const JointArray& velocity_rad_s;
  const JointArray& kp_nm_rad;
  const JointArray& kd_nm_s_rad;
};

struct Input {
  wire::Mode mode;
  std::uint32_t stale_ticks;  // ticks in a row without a new sample; 0 = fresh
  std::int64_t brain_age_ns;  // since the Brain's last sign of life; negative = never heard of
  const JointArray& position_rad;
  const JointArray& velocity_rad_s;
  const std::array<std::uint32_t, kMaxJoints>& joint_status;  // bits of wire::joint_status
  Proposal proposal;
};

// What may go to the drives. Always finite (position NaN = none) and within the limits, whatever came in.
struct Output {
  JointArray torque_nm{};
  JointArray position_rad{};
  JointArray velocity_rad_s{};
  JointArray kp_nm_rad{};
  JointArray kd_nm_s_rad{};
  JointArray max_torque_nm{};  // the drive's own last limit
};

// What keeps the robot safe, from the mildest to the last: each rung begins where the one above it has nothing more to
// do, and there is no way up but a person's reset.
enum class Rung : std::uint8_t { law, safe_law, brake, off };

struct Verdict {
  wire::Fault fault = wire::Fault::none;  // what the loop must latch
  std::uint32_t flags = 0;                // bits of wire::telemetry_flag
  bool use_safe_law = false;              // the output is the safe law's, not the proposal
  Rung rung = Rung::law;                  // brake and off: no output counts any more
};

// In the order of authority: not finite, drives, freshness and overrun -> safe law, in the same tick; then per joint
// soft stops, velocity, torque and last of all slew. Between two ticks the torque at the joint (feed-forward plus the
// drive's own PD at the measured state) never changes by more than torque_slew_nm_s / rate_hz, whoever proposes it:
// a law, its successor in a swap, or the safe law. Disarming and e-stop are at once. A joint whose sample is no basis
// for anything is braked by its drive, which still knows its own speed: the feed-forward fades, then damping grows to
// safe_kd_nm_s_rad, both within the slew bound up to the speed that is a fault.
// Contract: RT after configure() · owned by the tick thread · bounded work per joint
class Guard {
 public:
  void configure(const robot::RobotConfig& robot);

  // At arming, when the drives are off: the first step is bounded from 0. Also rearms the safe law.
  void reset_output() LITHE_RT;

  // The last output left for the drives: the next one is bounded from it. An output that never left bounds nothing.
  void dispatched() LITHE_RT;

  Verdict check(const Input& in, Output& out) LITHE_RT;

  // The torque each joint is expected to feel by the last output.
  const JointArray& expected_torque_nm() const LITHE_RT { return last_nm_; }

 private:
  struct Limits {
    double position_min_rad, position_max_rad;
    double soft_stop_per_rad;  // 1 / width of the fading zone
    double overrun_rad;
    double velocity_max_rad_s, velocity_fault_rad_s, velocity_fade_s_rad;
    double torque_max_nm, slew_nm;  // slew per tick
    double power_max_w;             // infinity = no limit
    double kp_max_nm_rad, kd_max_nm_s_rad;
    double blind_kd_nm_s_rad, blind_kd_step_nm_s_rad;  // damping of an unusable joint, and its growth per tick
  };

  wire::Fault judge(const Input& in, std::uint32_t& flags) LITHE_RT;
  wire::Fault judge_drives(const Input& in) const LITHE_RT;
  wire::Fault judge_motion(const Input& in) const LITHE_RT;
  bool proposal_is_finite(const Proposal& proposal) const LITHE_RT;
  void apply_law(const Input& in, Output& out, std::uint32_t& flags) LITHE_RT;
  void apply_safe_law(const Input& in, Output& out, std::uint32_t& flags) LITHE_RT;
  void brake_blindly(std::size_t j, Output& out, std::uint32_t& flags) LITHE_RT;
  void switch_off(Output& out) LITHE_RT;
  Rung descend(const Input& in) LITHE_RT;
  double powered(std::size_t j, double torque_nm, double velocity_rad_s, std::uint32_t& flags) const LITHE_RT;
  // The nearest torque to `wanted_nm` that limits and slew allow; remembers it as the joint's last.
  double bound(std::size_t j, double wanted_nm, double position_rad, double velocity_rad_s, double torque_max_nm,
               std::uint32_t& flags) LITHE_RT;

  std::array<Limits, kMaxJoints> limits_{};
  std::size_t joints_ = 0;
  std::uint32_t late_ticks_to_stop_ = 20;
  std::int64_t brain_stale_ns_ = 0;
  bool stop_when_brain_stale_ = false;
  double soft_start_ = 1, soft_start_step_ = 1;                // share of the torque limits that a law has
  std::uint64_t brake_after_ticks_ = 0, off_after_ticks_ = 0;  // at rest in the safe stop; 0 = never
  std::uint64_t ticks_at_rest_ = 0, ticks_seen_at_rest_ = 0;
  SafeLaw safe_law_;
  // By the last output, and by the last one that was dispatched: the torque, and the damping of an unusable joint,
  // whose torque nobody here knows.
  JointArray last_nm_{}, sent_nm_{};
  JointArray blind_kd_nm_s_rad_{}, sent_blind_kd_nm_s_rad_{};
  std::array<bool, kMaxJoints> usable_{};
};

}  // namespace lithe::guard
