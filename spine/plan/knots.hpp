// SPDX-License-Identifier: Apache-2.0
// The knots of one plan, a velocity at each, and the curve between them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/plan/check.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::plan {

// One joint between two knots: position = c0 + u (c1 + u (c2 + u c3)), u in seconds since the first of them.
struct Arc {
  double c0 = 0, c1 = 0, c2 = 0, c3 = 0;
  double position(double u) const LITHE_RT { return c0 + u * (c1 + u * (c2 + u * c3)); }
  double velocity(double u) const LITHE_RT { return c1 + u * (2 * c2 + u * 3 * c3); }
  double acceleration(double u) const LITHE_RT { return 2 * c2 + u * 6 * c3; }
};

// Contract: RT · plain data; one thread
struct Knots {
  static constexpr std::size_t kMost = wire::kNw + 1;  // the waypoints, and the present motion before them

  std::array<std::int64_t, kMost> t_ns{};
  std::array<JointArray, kMost> rad{};
  std::array<JointArray, kMost> rad_s{};
  std::size_t count = 0;

  void add(std::int64_t at_ns, const JointArray& position_rad, const JointArray& velocity_rad_s) LITHE_RT;
  void add(const wire::Plan& plan, std::size_t joints) LITHE_RT;  // velocities may be NaN until choose_velocities()

  // When all knots are there: a velocity for every one that has none, 0 at the end of a plan that is not continued,
  // else from the neighbours, never above the limit. The knots before `first` are over and keep theirs.
  void choose_velocities(const Limits& limits, const std::array<bool, kMaxJoints>& monotone, bool streaming,
                         std::size_t first) LITHE_RT;

  // The segment that holds at `now_ns`: from this knot to the next. 0 before the first knot.
  std::size_t segment_at(std::int64_t now_ns) const LITHE_RT;
  Arc arc(std::size_t knot, std::size_t j) const LITHE_RT;

  // A speed that each joint stays below from `now_ns` to the last knot. Cheap, and up to three times too high.
  void bound_speed(std::int64_t now_ns, std::size_t joints, JointArray& bound_rad_s) const LITHE_RT;
  // The highest speed of joint j on that way. Exact.
  double fastest(std::int64_t now_ns, std::size_t j) const LITHE_RT;
  // The same on one segment, from `from_s` after its first knot.
  double fastest_on(std::size_t knot, double from_s, std::size_t j) const LITHE_RT;

  // The largest acceleration of joint j on the segments from knot `first` on. Exact.
  double hardest(std::size_t first, std::size_t j) const LITHE_RT;

  double gap_s(std::size_t knot) const LITHE_RT { return static_cast<double>(t_ns[knot + 1] - t_ns[knot]) * 1e-9; }

 private:
  void measure(std::size_t joints) LITHE_RT;
  double velocity_from_neighbours(std::size_t knot, std::size_t j, bool monotone) const LITHE_RT;

  std::array<double, kMost> per_s_{};     // 1 / gap_s: a tick has no time for a division per joint and knot
  std::array<JointArray, kMost> rise_{};  // mean velocity to the next knot
};

}  // namespace lithe::plan
