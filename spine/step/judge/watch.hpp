// SPDX-License-Identifier: Apache-2.0
// The watch: judges a law for as long as it runs after its probation, against what it did itself on probation.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/resident.hpp"
#include "spine/robot/config.hpp"
#include "spine/robot/limits/drive_loop.hpp"
#include "spine/step/judge/probation.hpp"

namespace lithe::step {

// Time is divided into windows. Of each joint, a window is bad by a criterion, or not:
//   pushes_away      in a quarter of its ticks the joint was far from its setpoint, did not come nearer, and the law
//                    wanted a torque away from the setpoint that is larger than any load (load_max_nm)
//   gives_no_torque  nearly all the time the joint was far, and the law wanted almost no torque
//   shakes           it shakes (law::Tremor), and the torque does not clearly brake it
//   slewed           the guard slows the torque's change down in too many ticks (law/clamp_limits.hpp)
//   is_shaken        it shakes, and the torque brakes it
//   is_far           far on average, and none of these: a load, an obstacle, a drive with too little torque
// Far: beyond error_ratio times the largest error of the reference, at least kLeastErrorRad. For is_far and
// gives_no_torque this grows as the setpoint asks for more speed or acceleration than in the reference; slewed is not
// judged then. A bad window adds one to the score of the criterion, a good one takes one off. kAlarmScore is an alarm;
// kActScore of one of the first four is the law's fault. The last two never are: their cause may be outside the law.
//
// The reference of a law are the windows of its probation; of a law without one, its first kOwnReferenceS. A criterion
// that was true there is not judged at this joint: the law has another purpose. New parameters make a new reference.
// What the law wants is judged, not what the joint gets: limits, and drives that give less, are not its fault. Where a
// drive closes its own loop of velocity or position, away means a target speed above kMovingRadS, or a target
// kLeastErrorRad beyond the joint; its torque is not judged, but for shaking. With error_ratio 0 no error
// is. Where Probation judges no error (pauses, soft start) the window is dropped. Stopped joints are not judged.
// Contract: RT · owned by the tick thread · bounded work per joint, allocates nothing
class Watch {
 public:
  static constexpr double kWindowS = 0.25;
  static constexpr std::uint32_t kAlarmScore = 2, kActScore = 4;
  static constexpr double kOwnReferenceS = 2.0;

  struct News {
    Probation::News found;       // kind and evidence; none: nothing new
    bool is_laws_fault = false;  // else it is an alarm
    double toward_nm = 0;        // what the law wanted towards the setpoint, mean of the window
    bool any_far = false;        // a joint is far from its setpoint: the law that follows would chase it
  };

  void configure(const robot::RobotConfig& robot);
  // Once per tick in which `law` ran, after Probation has seen the tick.
  News see(const law::Resident& law, const Probation::Observed& tick, const Probation& probation) LITHE_RT;
  // Once per tick in which no law did.
  void rest() LITHE_RT {
    law_id_ = 0;
    suspects_ = false;
  }
  // Other parameters are in force: a new reference.
  void forget() LITHE_RT {
    own_->law_id = 0;
    rest();
  }
  // From an alarm until no window was bad for as long as it takes to act.
  bool suspects() const LITHE_RT { return suspects_; }

 private:
  enum Criterion : std::uint8_t { pushes_away, gives_no_torque, shakes, slewed, is_shaken, is_far };
  static constexpr std::uint32_t kCriteria = 6, kOfTheLaw = 4;  // so many, from the first on, are the law's fault

  struct Joint {
    double load_nm = 0, torque_max_nm = 1;
    robot::DriveLoop loop = robot::DriveLoop::torque;
  };
  struct Asked {  // the largest of the setpoint
    double rad_s = 0, rad_s2 = 0;
  };
  struct Window {  // of one joint
    std::uint32_t ticks = 0, pushed = 0, limp = 0;
    Asked asked;
    double most_error_rad = 0, most_nm = 0;
    double error_rad = 0, toward_nm = 0;  // sums
    double felt_nm = 0, speed_rad_s = 0, work = 0, felt_squared = 0,
           speed_squared = 0;  // measured torque, velocity error
  };
  struct OfJoint {
    double error_rad = 0;  // the largest mean of a window
    double most_nm = 0;
    Asked asked;
    std::uint32_t did = 0;  // a bit for each criterion that was true
  };
  struct Reference {
    std::uint32_t law_id = 0, windows = 0;
    bool closed = false;
    std::array<OfJoint, kMaxJoints> joints{};
  };

  void begin(const law::Resident& law, std::int64_t now_ns) LITHE_RT;
  void add(const Probation::Observed& tick, std::uint32_t j) LITHE_RT;
  double push_of(const Probation::Observed& tick, std::uint32_t j) const LITHE_RT;
  double far_rad(std::uint32_t j) const LITHE_RT;
  double asked_more(std::uint32_t j) const LITHE_RT;
  static bool brakes(const Window& now) LITHE_RT;
  std::uint32_t judge(const Probation& probation, std::uint32_t j) const LITHE_RT;
  void learn(std::uint32_t j, std::uint32_t bad) LITHE_RT;
  News end_window(const Probation& probation) LITHE_RT;
  News find(std::uint32_t score, std::uint32_t criteria, const Probation& probation) LITHE_RT;
  News tell(Criterion criterion, std::uint32_t j, const Probation& probation) const LITHE_RT;

  std::uint32_t window_ticks_ = 250, own_windows_ = 8, joints_ = 0;
  std::array<Joint, kMaxJoints> joint_{};

  std::array<Reference, law::kResidents> references_{};  // by the law's index
  Reference* own_ = references_.data();
  std::uint32_t law_id_ = 0;  // 0: none ran
  double error_ratio_ = 0;
  bool was_on_probation_ = false, suspects_ = false;
  std::int64_t from_ns_ = 0;             // nothing is judged before
  std::uint32_t ticks_ = 0, quiet_ = 0;  // of the window; windows without a bad one
  std::array<Window, kMaxJoints> window_{};
  std::array<Asked, kMaxJoints> before_{};       // in the window before
  std::array<std::uint32_t, kMaxJoints> bad_{};  // bits of the last window
  std::array<std::array<std::uint32_t, kCriteria>, kMaxJoints> score_{};
};

}  // namespace lithe::step
