// SPDX-License-Identifier: Apache-2.0
#include "tests/limits/rig.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>

#include "tests/limits/joints.hpp"

#include "tests/limits/promise.hpp"

namespace lithe::limits {
namespace {

using hal::sim::Plant;

constexpr double kStepS = 1e-9 * static_cast<double>(Plant::kStepNs);

// One drive as a moteus is: its own PD every 50 us, at least the damping that every command carries, a tracking loop
// for its speed.
struct Drive {
  Pd told;
  double max_nm = 0;
  double read_rad = 0, tracked_rad = 0, speed_rad_s = 0;

  double wanted_nm() const { return std::clamp(told.felt_nm(read_rad, speed_rad_s), -max_nm, max_nm); }
  void measure(double reading_rad) {
    constexpr double kPole = 2 * std::numbers::pi * 200;
    read_rad = reading_rad;
    const double error_rad = reading_rad - tracked_rad;
    speed_rad_s += kStepS * kPole * kPole * error_rad;
    tracked_rad += kStepS * (speed_rad_s + 2 * kPole * error_rad);
  }
};

struct Law {
  Law(const Run& of, std::size_t joints) : run(of), random(of.seed), held(joints, 0.0), side(joints, 1.0) {
    std::uniform_real_distribution<double> unit(0, 1);
    late_s = run.seconds * (0.2 + 0.5 * unit(random));
    for (double& each : side) each = unit(random) < 0.5 ? -1 : 1;
    for (std::size_t j = 0; j < joints; ++j) phase.push_back(6.28 * unit(random));
    hold_s = run.seconds * (0.01 + 0.3 * unit(random));
  }
  double symmetric() { return std::uniform_real_distribution<double>(-1, 1)(random); }

  void follow(std::size_t j, double t, double q, double v) {
    const robot::JointConfig& joint = run.robot.joints[j];
    const double middle = 0.5 * (joint.position_min_rad + joint.position_max_rad);
    const double wide = 0.4 * (joint.position_max_rad - joint.position_min_rad);
    const double want = middle + wide * std::sin(8 * t + phase[j]);
    torque[j] = 20 * joint.inertia_max_kg_m2 * (20 * (want - q) - v);
  }

  void step(double t, const JointArray& q, const JointArray& v) {
    for (std::size_t j = 0; j < run.robot.joints.size(); ++j) step(j, t, q[j], v[j]);
    next_s = t >= next_s ? t + hold_s : next_s;
  }
  void step(std::size_t j, double t, double q, double v) {
    const robot::JointConfig& joint = run.robot.joints[j];
    const double full = 1.5 * joint.torque_max_nm;
    const double middle = 0.5 * (joint.position_min_rad + joint.position_max_rad);
    const double range = joint.position_max_rad - joint.position_min_rad;
    const bool turn = t >= next_s;
    torque[j] = full * side[j];
    kp[j] = kd[j] = 0;
    target[j] = kNoTarget;
    switch (run.adversary) {
      case Adversary::one_way:
        return;
      case Adversary::late:
        if (t < late_s) follow(j, t, q, v);
        return;
      case Adversary::pumps:
        torque[j] = std::abs(v) < 0.01 ? full * side[j] : std::copysign(full, v);
        return;
      case Adversary::back_and_forth:
        if (std::abs(q - middle) > 0.4 * range) side[j] = q > middle ? -1 : 1;
        torque[j] = full * side[j];
        return;
      case Adversary::random_torque:
        torque[j] = full * symmetric();
        return;
      case Adversary::random_hold:
        if (turn) held[j] = full * (symmetric() > 0 ? 1 : -1);
        torque[j] = held[j];
        return;
      case Adversary::chatters:
        side[j] = -side[j];
        return;
      case Adversary::wrong_sign:
        torque[j] = 10 * joint.torque_max_nm / range * (q - middle) + 0.1 * side[j] * joint.torque_max_nm;
        return;
      case Adversary::switches_pd:
      case Adversary::pd_at_limits:
        return drive_pd(j, turn);
      case Adversary::fast_wall:
        if (side[j] * (q - middle) < 0.3 * range && std::abs(v) > 0.95 * joint.velocity_max_rad_s) torque[j] = 0;
        return;
      case Adversary::not_a_number:
        if (t > late_s) torque[j] = kNoTarget;
        return;
    }
  }

  // The drive's own PD.
  void drive_pd(std::size_t j, bool turn) {
    const robot::JointConfig& joint = run.robot.joints[j];
    if (run.adversary == Adversary::pd_at_limits) {
      if (turn) side[j] = -side[j];
      torque[j] = 1.5 * joint.torque_max_nm * side[j];
      target[j] = side[j] > 0 ? joint.position_max_rad : joint.position_min_rad;
      kp[j] = joint.kp_max_nm_rad;
      velocity[j] = side[j] * joint.velocity_max_rad_s;
      kd[j] = joint.kd_max_nm_s_rad;
      return;
    }
    if (turn || random() % 4 == 0) {
      const double middle = 0.5 * (joint.position_min_rad + joint.position_max_rad);
      held[j] = middle + (joint.position_max_rad - joint.position_min_rad) * symmetric();
      phase[j] = symmetric();
      side[j] = symmetric();
    }
    target[j] = phase[j] > -0.3 ? held[j] : kNoTarget;
    kp[j] = joint.kp_max_nm_rad * std::abs(side[j]);
    kd[j] = joint.kd_max_nm_s_rad * std::abs(phase[j]);
    torque[j] = 1.5 * joint.torque_max_nm * side[j];
    velocity[j] = joint.velocity_max_rad_s * symmetric();
  }

  const Run& run;
  std::mt19937_64 random;
  double late_s = 0, hold_s = 0, next_s = 0;
  std::vector<double> held, side, phase;
  Effort effort;
  JointArray &torque = effort.torque_nm, &target = effort.position_rad, &velocity = effort.velocity_rad_s,
             &kp = effort.kp_nm_rad, &kd = effort.kd_nm_s_rad;
};

class Player {
 public:
  explicit Player(const Run& run)
      : run_(run),
        joints_(run),
        count_(run.robot.joints.size()),
        law_(run, count_),
        random_(run.seed + 7),
        draws_(run.seed) {
    guard_.configure(run.robot);
    torque_nm_.resize(count_);
    std::mt19937_64 dice(run.seed + 55);
    for (std::size_t j = 0; j < count_; ++j)
      gain_.push_back(1 + std::uniform_real_distribution<double>(-run.gain_error, run.gain_error)(dice));
    for (std::size_t j = 0; j < count_; ++j) {
      const robot::JointConfig& joint = run.robot.joints[j];
      const double at = drives_[j].read_rad = drives_[j].tracked_rad = joints_.position_rad(j);
      from_above_[j] = at > 0.5 * (joint.position_min_rad + joint.position_max_rad);
    }
    if (run.recover) guard_.start_recovery();
    dividers_.resize(count_, 1);
    for (std::size_t j = 0; j < count_; ++j)
      if (run.robot.joints[j].device < run.robot.devices.size())
        dividers_[j] = run.robot.devices[run.robot.joints[j].device].rate_divider;
    look();
    before_ = sample_;
  }

  Extremes play() {
    const double period_s = 1 / run_.robot.rate_hz;
    const auto ticks = static_cast<std::uint64_t>(run_.seconds * run_.robot.rate_hz);
    const auto steps = static_cast<int>(std::lround(period_s / kStepS));
    std::uint32_t stale = 0;
    for (std::uint64_t tick = 0; tick < ticks; ++tick) {
      const double t = static_cast<double>(tick) * period_s;
      const bool late = run_.late_bus && stale < 3 && random_() % 10 == 0;
      stale = late ? stale + 1 : 0;
      if (!late) {
        extremes_.promise_share = std::max(extremes_.promise_share, promise_.share_of(output_));
        command();
        if (!run_.never_dispatched) guard_.dispatched();
        before_ = sample_;
        look();
        taken_ = t;
        ++exchanges_;
      }
      decide(t, stale);
      if (run_.watch) run_.watch(t, positions());
      for (int i = 0; i < steps; ++i) advance();
      ++extremes_.ticks;
    }
    for (std::size_t j = 0; j < count_; ++j) extremes_.end_rad = std::max(extremes_.end_rad, beyond_rad(j));
    return extremes_;
  }

 private:
  struct Sample {
    JointArray position{}, velocity{};
    std::array<std::uint32_t, kMaxJoints> status{};
  };

  // A drive is asked in one of so many exchanges; a late bus delays it and takes it no turn.
  bool asked(std::size_t j) const { return exchanges_ % dividers_[j] == 0; }

  void look() {
    for (std::size_t j = 0; j < count_; ++j) {
      if (!asked(j)) continue;
      const bool missed =
          run_.missed_answers && exchanges_ > 0 && missed_[j] < 8 && misses_() % 10 < (missed_[j] > 0 ? 9 : 1);
      missed_[j] = missed ? missed_[j] + 1 : 0;
      sample_.status[j] = missed ? 0 : wire::joint_status::kFresh;
      if (missed) continue;
      sample_.position[j] = drives_[j].read_rad;
      sample_.velocity[j] = drives_[j].speed_rad_s;
    }
  }

  // The last output reaches the drives that are asked in this tick.
  void command() {
    for (std::size_t j = 0; j < count_; ++j) {
      if (!asked(j)) continue;
      Drive& drive = drives_[j];
      const double before_nm = drive.wanted_nm();
      drive.max_nm = output_.max_torque_nm[j];
      if (run_.robot.devices[run_.robot.joints[j].device].kind == robot::DeviceKind::cia402) {
        // Our driver closes this PD loop once in an exchange, and the drive holds the torque until the next one.
        drive.told = {.torque_nm = pd_of(output_, j).felt_nm(sample_.position[j], sample_.velocity[j])};
        note_step(drive, j, before_nm);
        continue;
      }
      const double floor = std::max(output_.kd_nm_s_rad[j], run_.robot.joints[j].safe_kd_nm_s_rad);
      const double balance = (floor - output_.kd_nm_s_rad[j]) * sample_.velocity[j];
      drive.told = pd_of(output_, j);
      drive.told.torque_nm += balance;
      drive.told.kd_nm_s_rad = floor;
      if (floor > output_.kd_nm_s_rad[j]) drive.told.target_rad_s *= output_.kd_nm_s_rad[j] / floor;
      note_step(drive, j, before_nm);
    }
  }

  void note_step(const Drive& drive, std::size_t j, double before_nm) {
    const double step = run_.robot.joints[j].torque_slew_nm_s / run_.robot.rate_hz * dividers_[j];
    const double jump = std::abs(drive.wanted_nm() - before_nm);
    extremes_.step_share = std::max(extremes_.step_share, jump / step);
  }

  void decide(double t, std::uint32_t stale) {
    const Sample& sample = run_.transport_thread ? before_ : sample_;
    const double period_s = 1 / run_.robot.rate_hz;
    if (run_.law)
      run_.law(t, sample.position, sample.velocity, law_.effort);
    else
      law_.step(t, sample.position, sample.velocity);
    if (run_.unguarded) return pass_on();
    const double age_s = t - taken_ + (run_.transport_thread ? period_s : 0);
    const wire::Mode mode = run_.recover          ? wire::Mode::recover
                            : t >= run_.stop_at_s ? wire::Mode::safe_stop
                                                  : wire::Mode::active;
    promise_.expect(sample.position, sample.velocity, sample.status, age_s, stale);
    const auto began = std::chrono::steady_clock::now();
    const guard::Verdict verdict = guard_.check({mode, stale, 1'000'000, sample.position, sample.velocity,
                                                 sample.status, law_.effort, static_cast<std::int64_t>(1e9 * age_s)},
                                                output_);
    if (run_.check_ns != nullptr) run_.check_ns->push_back((std::chrono::steady_clock::now() - began).count());
    extremes_.changed += verdict.law_flags != 0;
    if (extremes_.fault == wire::Fault::none) extremes_.fault = verdict.fault;
  }

  JointArray positions() const {
    JointArray all{};
    for (std::size_t j = 0; j < count_; ++j) all[j] = joints_.position_rad(j);
    return all;
  }

  void pass_on() {
    for (std::size_t j = 0; j < count_; ++j) output_.set(j, pd_of(law_.effort, j), run_.robot.joints[j].torque_max_nm);
  }

  double beyond_rad(std::size_t j) const {
    const robot::JointConfig& joint = run_.robot.joints[j];
    const double q = joints_.position_rad(j);
    return std::max(q - joint.position_max_rad, joint.position_min_rad - q);
  }

  void advance() {
    for (std::size_t j = 0; j < count_; ++j)
      torque_nm_[j] = gain_[j] * drives_[j].wanted_nm() + (run_.bias_nm.empty() ? 0 : run_.bias_nm[j]);
    joints_.step(torque_nm_);
    for (std::size_t j = 0; j < count_; ++j) {
      const robot::JointConfig& joint = run_.robot.joints[j];
      const double q = joints_.position_rad(j), v = joints_.velocity_rad_s(j);
      drives_[j].measure(q + (run_.noise ? joint.sim.encoder_noise_rad * draws_.normal() : 0));
      extremes_.overrun_rad = std::max(extremes_.overrun_rad, beyond_rad(j));
      const double opposite = from_above_[j] ? joint.position_min_rad - q : q - joint.position_max_rad;
      extremes_.opposite_rad = std::max(extremes_.opposite_rad, opposite);
      const double fault = joint.velocity_max_rad_s * run_.robot.guard.velocity_overrun;
      extremes_.speed_share = std::max(extremes_.speed_share, std::abs(v) / fault);
    }
  }

  const Run& run_;
  Joints joints_;
  std::size_t count_;
  guard::Guard guard_;
  JointCommands output_;
  Promise promise_{run_.robot};
  Law law_;
  std::mt19937_64 random_;
  hal::sim::Draws draws_;
  std::uint64_t exchanges_ = 0;
  std::array<bool, kMaxJoints> from_above_{};
  std::array<Drive, kMaxJoints> drives_{};
  std::vector<std::uint32_t> dividers_;
  std::vector<double> torque_nm_, gain_;
  std::mt19937_64 misses_{run_.seed + 8};
  std::array<int, kMaxJoints> missed_{};
  Sample sample_, before_;
  double taken_ = 0;
  Extremes extremes_;
};

}  // namespace

std::string_view name_of(Adversary adversary) {
  constexpr std::array<std::string_view, kAdversaries> kNames{
      "one_way",  "late",       "pumps",       "back_and_forth", "random_torque", "random_hold",
      "chatters", "wrong_sign", "switches_pd", "pd_at_limits",   "fast_wall",     "not_a_number"};
  return kNames[static_cast<std::size_t>(adversary)];
}

Extremes play(const Run& run) { return Player(run).play(); }

}  // namespace lithe::limits
