// SPDX-License-Identifier: Apache-2.0
// The contract of a control law. A law is one C++ file:
//
//   #include <lithe/law.hpp>
//   struct Pd {
//     struct Params { lithe::Param kp_nm_rad{4, 0, 40}, kd_nm_s_rad{0.2, 0, 4}; };  // {value, min, max}: tuned live
//     struct State {};                                                              // carried to the next law by name
//     static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
//       for (std::uint32_t j = 0; j < t.joints; ++j)
//         u.torque_nm[j] = p.kp_nm_rad * (t.setpoint_position_rad[j] - t.position_rad[j]) -
//                          p.kd_nm_s_rad * t.velocity_rad_s[j];
//     }
//   };
//   LITHE_LAW(Pd, "pd");
//
// Contract: step() runs in the tick: no allocation, no lock, no system call, no globals, every loop bounded. What it
// must remember lives in State. Names end in their unit. Wrong State, Params or step() fail to compile with the reason.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <numbers>
#include <span>
#include <type_traits>

// These are the same as in spine/core, repeated so that a law needs this folder only.
#ifndef LITHE_NJ
#define LITHE_NJ 32
#endif
#if defined(__clang__) && __clang_major__ >= 20
#define LITHE_RT noexcept [[clang::nonblocking]]
// A law fault leaves these functions by a jump. RealtimeSanitizer counts nested LITHE_RT calls, so it must not count
// these.
#define LITHE_LEFT_BY_A_JUMP [[clang::no_sanitize("realtime")]]
#else
#define LITHE_RT noexcept
#define LITHE_LEFT_BY_A_JUMP
#endif

namespace lithe {

#ifndef LITHE_JOINTS_DEFINED
#define LITHE_JOINTS_DEFINED
inline constexpr std::size_t kMaxJoints = LITHE_NJ;
using JointArray = std::array<double, kMaxJoints>;
#endif

inline constexpr std::size_t kMaxProbes = 8;
inline constexpr std::size_t kMaxSensors = 16;
inline constexpr std::size_t kMaxInputs = 16;
inline constexpr std::size_t kMaxParams = 32;
inline constexpr std::size_t kMaxStateFields = 32;
inline constexpr std::size_t kMaxStateBytes = 4096;
inline constexpr std::size_t kMaxNameChars = 31;
inline constexpr double kAbsent = std::numeric_limits<double>::quiet_NaN();

// Bits of Tick::flags.
inline constexpr std::uint32_t kSampleStale = 1;  // position, velocity and torque are those of an earlier tick
inline constexpr std::uint32_t kBrainStale = 2;   // no fresh plan: the setpoint coasts to a stop and holds
inline constexpr std::uint32_t kInputStale =
    4;  // no input for longer than [brain] stale_after_s: they keep their values

// The input of a law in each tick. Only the first `joints` entries of each array are valid.
struct Tick {
  std::uint64_t tick = 0;
  std::int64_t t_ns = 0;  // CLOCK_MONOTONIC
  double t_s = 0;         // since this law's first tick
  double dt_s = 0;        // one tick
  std::uint32_t joints = 0;
  std::uint32_t flags = 0;
  double sample_age_s = 0;
  double brain_age_s = 0;  // infinity: no Brain has connected yet
  JointArray position_rad{}, velocity_rad_s{}, torque_nm{};
  JointArray setpoint_position_rad{}, setpoint_velocity_rad_s{}, setpoint_acceleration_rad_s2{};
  std::array<double, kMaxSensors> sensor{};
  std::array<double, kMaxInputs> input{};  // [[input]] of the robot file: what the Brain wants of the law, within range
  double input_age_s = 0;                  // infinity: none has come yet, they have the file's values
};

// The output of a law. Cleared before each step; most laws write torque_nm only.
struct Effort {
  JointArray torque_nm{};     // feed-forward torque
  JointArray position_rad{};  // position target of the drive's own PD loop, kAbsent = none
  JointArray velocity_rad_s{};
  JointArray kp_nm_rad{}, kd_nm_s_rad{};  // gains of the drive's own PD loop

  void clear(std::uint32_t joints) LITHE_RT {
    for (std::uint32_t j = 0; j < joints && j < kMaxJoints; ++j) {
      torque_nm[j] = velocity_rad_s[j] = kp_nm_rad[j] = kd_nm_s_rad[j] = 0;
      position_rad[j] = kAbsent;
    }
  }
};

// One tick of the past.
struct PastTick {
  double age_s = 0;                                          // before now
  JointArray position_rad{}, velocity_rad_s{}, torque_nm{};  // measured
  JointArray setpoint_position_rad{}, setpoint_velocity_rad_s{};
  JointArray command_torque_nm{};            // the output of the guard
  std::array<double, kMaxSensors> sensor{};  // as Tick::sensor
};

// The robot's last two seconds (at 1 kHz), for a law whose filters or integrators should not start from zero:
//   static void init(const lithe::History& past, const Params& p, State& s);
// It runs once, off the tick, after the defaults and before fields of the same name are carried over from the law that
// is being replaced. The newest tick comes first. `count` may be 0: the robot has just started. All values are finite:
// ticks with a non-finite value are left out.
struct History {
  const PastTick* ticks = nullptr;
  std::uint32_t count = 0;
  std::uint32_t joints = 0;
  double dt_s = 0;  // between two of them; ticks that were missed are left out

  const PastTick& operator[](std::uint32_t i) const LITHE_RT { return ticks[i]; }
  const PastTick* begin() const LITHE_RT { return ticks; }
  const PastTick* end() const LITHE_RT { return ticks + count; }
};

// One tunable number. The Spine never lets `value` leave [min, max].
struct Param {
  double value = 0;
  double min = 0;
  double max = 0;
  constexpr operator double() const LITHE_RT { return value; }  // NOLINT(google-explicit-constructor)
};

}  // namespace lithe

#include "lithe/describe.hpp"

// Ends every law file: LITHE_LAW(Type, "name"). The name is shown in `lithe status` and in telemetry.
#define LITHE_LAW(Type, law_name)                                                                              \
  static_assert(sizeof(law_name) > 1 && sizeof(law_name) <= 64, "LITHE: a law's name has 1 to 63 characters"); \
  extern "C" __attribute__((visibility("default"))) const LitheLaw lithe_law;                                  \
  constinit const LitheLaw lithe_law = ::lithe::describe<Type>(law_name);                                      \
  static_assert(::lithe::contract::ranges_hold(::lithe::describe<Type>(law_name)),                             \
                "LITHE: a Param is {value, min, max} with min <= value <= max, all finite: lithe::Param kp{4, 0, 40}")
