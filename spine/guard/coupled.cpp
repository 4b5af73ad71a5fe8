// SPDX-License-Identifier: Apache-2.0
// A robot with a model: what each joint shall do is proposed as without one, then all torques are bounded together.
#include <algorithm>
#include <cmath>

#include "spine/guard/guard.hpp"

namespace lithe::guard {
namespace {

namespace flag = wire::telemetry_flag;

constexpr double kNegligibleNm = 1e-9;

}  // namespace

void Guard::observe(const Input& in) LITHE_RT {
  std::array<bool, kMaxJoints> fresh{};
  for (std::size_t j = 0; j < joints_; ++j)
    fresh[j] = joint_[j].usable && (in.joint_status[j] & wire::joint_status::kFresh) != 0;
  together_->observer().observe(
      {in.position_rad, in.velocity_rad_s, fresh, 1e-9 * static_cast<double>(in.sample_age_ns)});
}

// What law or safe law want of a joint at the predicted state, within torque, power and gains.
Guard::Proposal Guard::propose_law(std::size_t j, const Input& in) LITHE_RT {
  safe_law_.rearm(j);
  const Joint& joint = joint_[j];
  const Limits& limit = joint.limit;
  const JointStates& at = together_->observer().next();
  Proposal proposal{.command = Command{pd_of(in.effort, j)}, .most_nm = limit.torque_max_nm * soft_start_};
  Command& command = proposal.command;
  command.kp_nm_rad =
      has_target(command.target_rad) ? std::clamp(command.kp_nm_rad, 0.0, together_->kp_most_nm_rad(j)) : 0.0;
  command.kd_nm_s_rad = std::clamp(command.kd_nm_s_rad, 0.0, together_->kd_most_nm_s_rad(j));
  command.target_rad = std::clamp(command.target_rad, limit.position_min_rad, limit.position_max_rad);  // NaN stays NaN
  command.target_rad_s = std::clamp(command.target_rad_s, -limit.velocity_max_rad_s, limit.velocity_max_rad_s);
  proposal.wanted_nm = command.Pd::felt_nm(at.position_rad[j], at.tracked_rad_s[j]);
  settle_gains(joint, {at.position_rad[j], at.velocity_rad_s[j], 0, 0}, command);
  return proposal;
}

Guard::Proposal Guard::propose_safe_law(std::size_t j) LITHE_RT {
  const JointStates& at = together_->observer().next();
  Proposal proposal{.most_nm = joint_[j].limit.torque_max_nm};
  settle_gains(joint_[j], {at.position_rad[j], at.velocity_rad_s[j], 0, 0}, proposal.command);
  proposal.command.kp_nm_rad = 0;  // the position target is the law's
  proposal.wanted_nm = safe_law_.torque_nm(j, at.position_rad[j], at.velocity_rad_s[j]);
  return proposal;
}

// Also of a recovery, which is slow: there each joint is bounded alone.
void Guard::tell_observer(const JointCommands& out) LITHE_RT {
  if (together_ == nullptr) return;
  for (std::size_t j = 0; j < joints_; ++j) together_->observer().command(j, pd_of(out, j), out.max_torque_nm[j]);
}

void Guard::choose(std::size_t j, const Proposal& proposal, Choice& choice, JointArray& torque_nm, std::uint32_t& flags)
    LITHE_RT {
  const Limits& limit = joint_[j].limit;
  const double felt_nm = together_->observer().felt_nm(j), step_nm = together_->slew_step_nm(j);
  const double speed_rad_s = together_->observer().next().velocity_rad_s[j];
  choice.least_nm[j] = std::clamp(felt_nm - step_nm, -limit.torque_max_nm, limit.torque_max_nm);
  choice.most_nm[j] = std::clamp(felt_nm + step_nm, -limit.torque_max_nm, limit.torque_max_nm);
  const double clamped = std::clamp(proposal.wanted_nm, -proposal.most_nm, proposal.most_nm);
  const bool strong = !(clamped * speed_rad_s <= limit.power_max_w);  // braking is not limited
  const double powered = strong ? limit.power_max_w / speed_rad_s : clamped;
  torque_nm[j] = std::clamp(powered, choice.least_nm[j], choice.most_nm[j]);
  if (strong) flags |= flag::kPowerClamped;
  if (clamped != proposal.wanted_nm) flags |= flag::kTorqueClamped;
  if (torque_nm[j] != powered) flags |= flag::kSlewClamped;
}

// Makes the command that has this torque at the predicted state.
void Guard::settle_torque(std::size_t j, const Input& in, Command command, double torque_nm, double most_nm,
                          JointCommands& out) LITHE_RT {
  Joint& joint = joint_[j];
  const JointStates& at = together_->observer().next();
  const double tracked = at.tracked_rad_s[j], limit_nm = joint.limit.torque_max_nm;
  // The feed-forward compensates the drive's PD; where it cannot, the gains are reduced.
  const double drive_nm = command.Pd::pd_nm(at.position_rad[j], tracked);
  command.torque_nm = torque_nm - drive_nm;
  if (std::abs(command.torque_nm) > limit_nm) {
    command.torque_nm = std::copysign(limit_nm, command.torque_nm);
    const double share = std::clamp((torque_nm - command.torque_nm) / drive_nm, 0.0, 1.0);
    command.kp_nm_rad *= share;
    command.kd_nm_s_rad *= share;
  }
  // The damping that a drive adds in any case is told here, around the predicted speed: nothing is left to add.
  const double damping = joint.limit.blind_kd_nm_s_rad;
  if (command.kd_nm_s_rad < damping) {
    command.target_rad_s =
        (command.kd_nm_s_rad * command.target_rad_s + (damping - command.kd_nm_s_rad) * tracked) / damping;
    command.kd_nm_s_rad = damping;
  }
  remember(joint, measured(j, in), command);
  out.set(j, command, most_nm);
}

void Guard::decide_together(const Input& in, JointCommands& out, Verdict& verdict) LITHE_RT {
  std::array<Proposal, kMaxJoints> proposal{};
  Choice choice;
  JointArray torque_nm{};
  for (std::size_t j = 0; j < joints_; ++j) {
    Joint& joint = joint_[j];
    joint.rung = group_[joint.group].rung;
    joint.law_flags = 0;
    std::uint32_t& flags = joint.rung == Rung::law ? joint.law_flags : verdict.flags;
    const bool blind = joint.rung == Rung::safe_law && !joint.usable;
    if (blind || (joint.rung != Rung::law && joint.rung != Rung::safe_law)) {
      safe_law_.rearm(j);
      if (blind) brake_blindly(j, out, verdict.flags);
      if (!blind) switch_off(j, out);
      choice.ignored[j] = true;
      torque_nm[j] = choice.least_nm[j] = choice.most_nm[j] = together_->observer().felt_nm(j);
      continue;
    }
    proposal[j] = joint.rung == Rung::law ? propose_law(j, in) : propose_safe_law(j);
    choose(j, proposal[j], choice, torque_nm, flags);
  }
  const JointArray slewed_nm = torque_nm;
  together_->bound(choice, torque_nm);
  for (std::size_t j = 0; j < joints_; ++j) {
    Joint& joint = joint_[j];
    if (!choice.ignored[j]) {
      joint.at_envelope = std::abs(torque_nm[j] - slewed_nm[j]) > kNegligibleNm;
      if (joint.at_envelope) (joint.rung == Rung::law ? joint.law_flags : verdict.flags) |= flag::kPositionClamped;
      // Also valid if no other command follows. Braking torque may exceed the limit of soft start.
      settle_torque(j, in, proposal[j].command, torque_nm[j], std::max(proposal[j].most_nm, std::abs(torque_nm[j])),
                    out);
    }
    verdict.law_flags |= joint.law_flags;
  }
  verdict.flags |= verdict.law_flags;
  tell_observer(out);
}

}  // namespace lithe::guard
