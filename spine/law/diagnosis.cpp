// SPDX-License-Identifier: Apache-2.0
#include "spine/law/diagnosis.hpp"

#include <algorithm>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <numbers>
#include <optional>

namespace lithe::law {
namespace {

enum Value : std::size_t { kSetpoint, kPosition, kVelocity, kSetpointVelocity, kTorque };
constexpr std::size_t kInputs = 4;

constexpr std::uint32_t kLeastTicks = 30;  // fewer prove nothing
// The law is taken as linear in its inputs when that explains so much of its torque. Noise does not lower this: what is
// compared is what the law saw.
constexpr double kExplained = 0.9999;
// Each input must vary by this share of its own: a joint that follows its setpoint closely does not tell them apart.
constexpr double kOwn = 1e-4;
// A gain counts when it makes up this share of the torque's variation.
constexpr double kWorth = 0.1;
constexpr double kDegree = 180 / std::numbers::pi, kDegreeTolerance = 0.03;
constexpr double kOffRad = 0.02;                  // an error worth a word
constexpr double kSteadyShare = 0.85;             // the mean of a steady error is nearly its root mean square
constexpr double kLittleDamping = 0.05;           // damping ratio
constexpr double kTinyErrorRad = 1e-3;            // no encoder is so fine that all of the torque makes sense for it
constexpr double kUsualErrorRad = 0.1;            // at which a stiffness asks for all of the torque
constexpr double kAtLimit = 0.1, kAgainst = 0.2;  // shares of ticks
constexpr double kStalled = 0.005;                // of its setpoint's motion
constexpr double kQuarter = 0.25;                 // of a gain that is too high: a margin of 4 where it just swung
constexpr double kIntegralPerS = 4;               // of a stiffness: takes a steady load in about a second

std::size_t place(std::size_t a, std::size_t b) {
  const std::size_t low = std::min(a, b), high = std::max(a, b);
  return high * (high + 1) / 2 + low;
}

double mean(const JointSums& sums, Value value) { return sums.sum[value] / sums.ticks; }

double covariance(const JointSums& sums, std::size_t a, std::size_t b) {
  return sums.product[place(a, b)] / sums.ticks - sums.sum[a] / sums.ticks * (sums.sum[b] / sums.ticks);
}

double mean_error_rad(const JointSums& sums) { return mean(sums, kSetpoint) - mean(sums, kPosition); }

double rms_error_rad(const JointSums& sums) {
  const auto of = [&sums](std::size_t a, std::size_t b) { return sums.product[place(a, b)] / sums.ticks; };
  const double square = of(kSetpoint, kSetpoint) - 2 * of(kSetpoint, kPosition) + of(kPosition, kPosition);
  return std::sqrt(std::max(0.0, square));
}

// Slopes of the torque over each input, by least squares.
struct Gains {
  std::array<double, kInputs> slope{};
  std::array<double, kInputs> share{};  // |slope| times the input's variation, of the torque's
};

// Empty when the inputs did not move apart, or do not explain the torque.
std::optional<Gains> fit(const JointSums& sums) {
  if (sums.ticks < kLeastTicks) return std::nullopt;
  const double torque = covariance(sums, kTorque, kTorque);
  if (!(torque > 0) || !std::isfinite(torque)) return std::nullopt;
  std::array<std::array<double, kInputs + 1>, kInputs> rows{};
  std::array<bool, kInputs> used{};
  for (std::size_t i = 0; i < kInputs; ++i) {
    used[i] = covariance(sums, i, i) > 1e-12;  // a setpoint at rest explains nothing
    for (std::size_t k = 0; k < kInputs; ++k) rows[i][k] = covariance(sums, i, k);
    rows[i][kInputs] = covariance(sums, i, kTorque);
  }
  // Gauss and Jordan; what is left of a diagonal element is the input's variation that the others do not explain.
  for (std::size_t i = 0; i < kInputs; ++i) {
    if (!used[i]) continue;
    if (!(rows[i][i] > kOwn * covariance(sums, i, i))) return std::nullopt;
    for (std::size_t k = 0; k < kInputs; ++k) {
      if (k == i || !used[k]) continue;
      const double factor = rows[k][i] / rows[i][i];
      for (std::size_t c = 0; c <= kInputs; ++c) rows[k][c] -= factor * rows[i][c];
    }
  }
  Gains gains;
  double explained = 0;
  for (std::size_t i = 0; i < kInputs; ++i) {
    if (!used[i]) continue;
    gains.slope[i] = rows[i][kInputs] / rows[i][i];
    gains.share[i] = std::abs(gains.slope[i]) * std::sqrt(covariance(sums, i, i) / torque);
    explained += gains.slope[i] * covariance(sums, i, kTorque) / torque;
  }
  return explained >= kExplained ? std::optional(gains) : std::nullopt;
}

bool is_degrees(double ratio) {
  return std::abs(ratio / kDegree - 1) < kDegreeTolerance || std::abs(ratio * kDegree - 1) < kDegreeTolerance;
}

__attribute__((format(printf, 2, 3))) Diagnosis told(Diagnosis::Kind kind, const char* format, ...) {
  Diagnosis diagnosis;
  diagnosis.kind = kind;
  va_list values;
  va_start(values, format);
  std::vsnprintf(diagnosis.text.data(), diagnosis.text.size(), format, values);
  va_end(values);
  return diagnosis;
}

// How fast it swings: as was found, else from the speed that belongs to its error.
double swing_rad_s(const JointSums& sums, const JointSeen& seen) {
  if (seen.swing_hz > 0) return 2 * std::numbers::pi * seen.swing_hz;
  const double error = covariance(sums, kSetpoint, kSetpoint) - 2 * covariance(sums, kSetpoint, kPosition) +
                       covariance(sums, kPosition, kPosition);
  return error > 0 ? std::sqrt(covariance(sums, kVelocity, kVelocity) / error) : 0;
}

// "lower the stiffness to about 50 and the damping to about 0.25". Of two gains that push alike at that frequency
// both are lowered; half of the damping belongs to a quarter of the stiffness, unless the damping pushes more.
std::array<char, 96> lower(double stiffness, double damping, double w_rad_s) {
  std::array<char, 96> text{};
  const bool damps_more = damping * w_rad_s > stiffness;
  if (stiffness > 0 && damping > 0)
    std::snprintf(text.data(), text.size(), "lower the stiffness to about %.3g and the damping to about %.3g",
                  kQuarter * stiffness, (damps_more ? kQuarter : 2 * kQuarter) * damping);
  else
    std::snprintf(text.data(), text.size(), "lower the %s to about %.3g", stiffness > 0 ? "stiffness" : "damping",
                  kQuarter * std::max(stiffness, damping));
  return text;
}

// Of a law whose torque is explained by its inputs.
Diagnosis from_gains(const Gains& gains, const JointSums& sums, const JointSeen& seen) {
  using Kind = Diagnosis::Kind;
  const double stiffness = -gains.slope[kPosition], damping = -gains.slope[kVelocity];
  const bool of_position = gains.share[kPosition] >= kWorth, of_velocity = gains.share[kVelocity] >= kWorth;
  if (of_position && stiffness < 0) {
    return told(Kind::wrong_sign,
                "joint %s: its torque grows with its position (measured: %+.3g N m per rad), away from the setpoint: "
                "change the sign of that term, to gain * (setpoint - position)",
                seen.joint, -stiffness);
  }
  if (of_velocity && damping < 0) {
    return told(Kind::wrong_damping_sign,
                "joint %s: its torque grows with its velocity (measured: %+.3g N m per rad/s), which feeds the motion: "
                "subtract gain * velocity instead, and begin with a gain of %.2g",
                seen.joint, -damping, -kQuarter * damping);
  }
  if (of_position && gains.slope[kSetpoint] != 0 && is_degrees(gains.slope[kSetpoint] / stiffness)) {
    return told(Kind::degrees,
                "joint %s: position and setpoint count with gains of %.3g and %.3g N m per rad, a ratio of 57.3: one "
                "of them is in degrees; all angles are in rad",
                seen.joint, stiffness, gains.slope[kSetpoint]);
  }
  for (const double value : seen.params) {
    if (!of_position || value == 0 || std::abs(stiffness / value / kDegree - 1) > kDegreeTolerance) continue;
    return told(Kind::degrees,
                "joint %s: its stiffness is %.4g N m/rad, 57.3 times the parameter %.4g: an error in degrees; all "
                "angles are in rad",
                seen.joint, stiffness, value);
  }
  const double w_rad_s = swing_rad_s(sums, seen);
  const auto lower_them = lower(of_position ? stiffness : 0, of_velocity ? damping : 0, w_rad_s);
  if (seen.swing_hz > 0 && (of_position || of_velocity)) {
    if (of_position && seen.torque_max_nm > 0 && seen.torque_max_nm / stiffness < kTinyErrorRad) {
      return told(
          Kind::gain_too_high,
          "joint %s: measured stiffness %.3g N m/rad: an error of %.1g rad asks for all of its %.3g N m, and it "
          "swings at %.1f Hz: lower the stiffness to about %.2g, which asks for that at %.1g rad",
          seen.joint, stiffness, seen.torque_max_nm / stiffness, seen.torque_max_nm, seen.swing_hz,
          seen.torque_max_nm / kUsualErrorRad, kUsualErrorRad);
    }
    if (of_position && 0.5 * damping * w_rad_s / stiffness < kLittleDamping) {
      return told(Kind::no_damping,
                  "joint %s: measured stiffness %.3g N m/rad, damping %.2f N m s/rad: too little damping for its swing "
                  "of %.1f Hz: subtract gain * velocity, with a gain of about %.2g",
                  seen.joint, stiffness, std::max(damping, 0.0), seen.swing_hz, stiffness / w_rad_s);
    }
    return told(Kind::gain_too_high,
                "joint %s: measured stiffness %.3g N m/rad, damping %.2g N m s/rad, and it swings at %.1f Hz: %s",
                seen.joint, stiffness, damping, seen.swing_hz, lower_them.data());
  }
  if (of_position && sums.at_limit > kAtLimit * sums.ticks) {
    return told(Kind::gain_too_high,
                "joint %s: measured stiffness %.3g N m/rad, damping %.2g N m s/rad: an error of %.2g rad asks for all "
                "of its %.3g N m: %s",
                seen.joint, stiffness, damping, seen.torque_max_nm / stiffness, seen.torque_max_nm, lower_them.data());
  }
  return {};
}

// Its setpoint moves and it does not, although it is pushed. No gain is to blame as long as nothing moves.
Diagnosis stalled(const JointSums& sums, const JointSeen& seen) {
  const double asked_rad = std::sqrt(std::max(0.0, covariance(sums, kSetpoint, kSetpoint)));
  const double moved_rad = std::sqrt(std::max(0.0, covariance(sums, kPosition, kPosition)));
  if (asked_rad < kOffRad || moved_rad > kStalled * asked_rad) return {};
  if (sums.most_nm >= seen.torque_max_nm)
    return told(Diagnosis::Kind::stalled,
                "joint %s: it does not move although the law asked for all of its %.3g N m: a load or friction above "
                "its torque holds it, or it is blocked: look at the joint first; gains do not help",
                seen.joint, seen.torque_max_nm);
  return told(Diagnosis::Kind::stalled,
              "joint %s: it does not move while its setpoint does; the law asked for at most %.3g of its %.3g N m: "
              "friction or a load holds it: give it more torque first (a term for friction or gravity), then look at "
              "the gains",
              seen.joint, sums.most_nm, seen.torque_max_nm);
}

}  // namespace

void JointSums::see(const Sample& sample, double torque_max_nm) {
  const std::array<double, kValues> values{sample.setpoint_rad, sample.position_rad, sample.velocity_rad_s,
                                           sample.setpoint_rad_s, sample.wanted_nm};
  if (!std::all_of(values.begin(), values.end(), [](double value) { return std::isfinite(value); })) return;
  ++ticks;
  most_nm = std::max(most_nm, std::abs(sample.wanted_nm));
  const bool full = std::abs(sample.wanted_nm) >= torque_max_nm;
  at_limit += full ? 1 : 0;
  const double error_rad = sample.setpoint_rad - sample.position_rad;
  const bool unwinds = sample.wanted_nm * error_rad < 0 && (sample.wanted_nm - last_nm) * error_rad > 0;
  at_limit_unwinding += full && unwinds ? 1 : 0;
  last_nm = sample.wanted_nm;
  for (std::size_t i = 0; i < kValues; ++i) {
    sum[i] += values[i];
    for (std::size_t k = 0; k <= i; ++k) product[place(i, k)] += values[i] * values[k];
  }
}

Diagnosis diagnose(const JointSums& sums, const JointSeen& seen) {
  using Kind = Diagnosis::Kind;
  if (sums.ticks < kLeastTicks) return {};
  const double off_rad = mean_error_rad(sums), rms_rad = rms_error_rad(sums);
  if (sums.most_nm == 0) {
    if (rms_rad < kOffRad) return {};
    return told(Kind::no_torque,
                "joint %s: the law gave it no torque at all, with an error of %.2g rad (rms): let its loop reach every "
                "joint, j = 0 to t.joints - 1",
                seen.joint, rms_rad);
  }
  if (Diagnosis found = stalled(sums, seen); found.kind != Kind::none) return found;
  const auto gains = fit(sums);
  if (gains && seen.refused) {
    Diagnosis found = from_gains(*gains, sums, seen);
    if (found.kind != Kind::none) return found;
  }
  const double limited = static_cast<double>(sums.at_limit) / sums.ticks;
  if (!gains && limited > kAtLimit && sums.at_limit_unwinding > kAgainst * sums.at_limit) {
    return told(Kind::wind_up,
                "joint %s: in %.0f %% of ticks the law asked for all of its torque, in %.0f %% of these although the "
                "error had changed its sign: an integral that winds up; begin with a tenth of its gain, and let "
                "the integral give at most %.3g N m",
                seen.joint, 100 * limited, 100.0 * sums.at_limit_unwinding / sums.at_limit,
                kQuarter * seen.torque_max_nm);
  }
  const double pushed_nm = mean(sums, kTorque);
  const bool steady = std::abs(off_rad) >= kOffRad && std::abs(off_rad) >= kSteadyShare * rms_rad;
  if (steady && limited < kAtLimit && pushed_nm * off_rad > 0) {
    return told(
        Kind::steady_load,
        "joint %s: it stays %.3f rad %s its setpoint while it pushes with %.2g N m on average: a steady load, as "
        "gravity is: add a term for it (laws/gravity_pd.cpp), or an integral with a gain of about %.2g N m/(rad s)",
        seen.joint, std::abs(off_rad), off_rad > 0 ? "below" : "above", std::abs(pushed_nm),
        kIntegralPerS * pushed_nm / off_rad);
  }
  return {};
}

}  // namespace lithe::law
