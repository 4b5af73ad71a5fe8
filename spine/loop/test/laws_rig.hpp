// SPDX-License-Identifier: Apache-2.0
// Fixture for spine/step/laws.cpp: laws of every kind, and readers of the Spine's events and records.
#pragma once

#include <algorithm>
#include <cstring>
#include <optional>
#include <span>
#include <vector>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {

using wire::EventKind;
using wire::LawFaultKind;
namespace flag = wire::telemetry_flag;

// Pd with another structure: an added constant, and its own state.
struct Lifted {
  struct Params {};
  struct State {
    double integral_rad_s = 0;
    double calls = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.calls += 1;
    u.torque_nm[0] = 4.0 * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0] + 0.3;
  }
};
struct LateNan {  // finite for ten steps
  struct Params {};
  struct State {
    double steps = 0;
  };
  static void step(const Tick&, const Params&, State& s, Effort& u) {
    u.torque_nm[0] = ++s.steps > 10 ? std::numeric_limits<double>::quiet_NaN() : 0.0;
  }
};
inline volatile std::uintptr_t kNowhere = 8;
struct Crash {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) {
    u.torque_nm[0] = *reinterpret_cast<const double*>(kNowhere);
  }
};
struct Scribble {  // overwrites all its inputs, also through const
  struct Params {
    Param gain{1, 0, 2};
  };
  struct State {
    double integral_rad_s = 0;
  };
  static void step(const Tick& t, const Params& p, State& s, Effort& u) {
    std::memset(const_cast<void*>(static_cast<const void*>(&t)), 0xff, sizeof t);
    std::memset(const_cast<void*>(static_cast<const void*>(&p)), 0xff, sizeof p);
    std::memset(static_cast<void*>(&s), 0xff, sizeof s);
    u.torque_nm[0] = std::numeric_limits<double>::infinity();
  }
};

struct Integrate {  // its state is its output
  struct Params {};
  struct State {
    double integral_nm = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.integral_nm += t.dt_s * (t.setpoint_position_rad[0] - t.position_rad[0]);
    u.torque_nm[0] = s.integral_nm;
  }
};
struct Poisoner {  // its state never shows in its output
  struct Params {};
  struct State {
    double integral_nm = 0;
    double calls = 0;
  };
  static void step(const Tick&, const Params&, State& s, Effort&) {
    s.calls += 1;
    s.integral_nm = std::numeric_limits<double>::quiet_NaN();
  }
};
struct Lazy {  // holds its position, does not track
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) { u.torque_nm[0] = -0.2 * t.velocity_rad_s[0]; }
};
struct Chatters {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    u.torque_nm[0] = 4.0 * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0] +
                     (t.tick % 2 == 0 ? 0.2 : -0.2);
  }
};
struct Hammers {  // below the frequency of chatter, too fast for the joint to swing far
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    u.torque_nm[0] = 4.0 * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0] +
                     (t.tick / 9 % 2 == 0 ? 0.4 : -0.4);
  }
};
struct Swings {  // negative damping
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    u.torque_nm[0] = 4.0 * (t.setpoint_position_rad[0] - t.position_rad[0]) + 0.012 * t.velocity_rad_s[0];
  }
};
struct Tuned {
  struct Params {
    Param bias_nm{0, 0, 1}, kd_nm_s_rad{0.1, -1, 1};
  };
  struct State {};
  static void step(const Tick& t, const Params& p, State&, Effort& u) {
    u.torque_nm[0] = 4.0 * (t.setpoint_position_rad[0] - t.position_rad[0]) - p.kd_nm_s_rad * t.velocity_rad_s[0] +
                     0.01 * p.bias_nm / (1 - p.bias_nm);
  }
};
struct Clock {  // outputs its own time
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) { u.torque_nm[0] = 0.1 * t.t_s; }
};
inline std::span<std::byte> kPrey;  // memory that a test provides
struct Raise {                      // overwrites every 0.6 there; one of them is the torque limit
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort&) {
    for (std::size_t at = 0; at + sizeof(double) <= kPrey.size(); at += sizeof(double)) {
      double value = 0;
      std::memcpy(&value, &kPrey[at], sizeof value);
      if (value == 0.6) std::memcpy(&kPrey[at], "\0\0\0\0\0\0\xf0\x7f", sizeof value);  // infinite
    }
  }
};
struct Huge {  // overflows the torque through the drive's own stiffness
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    u.kp_nm_rad[0] = 1e308;
    u.position_rad[0] = t.position_rad[0] + 1e3;
  }
};

// Holds the joint beside the setpoint.
template <int kNumber>
struct Beside {
  static inline double off_rad = 0;
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    u.torque_nm[0] = 4 * (t.setpoint_position_rad[0] + off_rad - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0];
  }
};
struct PushesLater {
  static inline bool now = false;
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    u.torque_nm[0] = now ? 1.0 : 4 * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0];
  }
};

inline constexpr LitheLaw kLifted = describe<Lifted>("lifted");
inline constexpr LitheLaw kLateNan = describe<LateNan>("late_nan");
inline constexpr LitheLaw kCrash = describe<Crash>("crash");
inline constexpr LitheLaw kScribble = describe<Scribble>("scribble");
inline constexpr LitheLaw kIntegrate = describe<Integrate>("integrate");
inline constexpr LitheLaw kPoisoner = describe<Poisoner>("poisoner");
inline constexpr LitheLaw kLazy = describe<Lazy>("lazy");
inline constexpr LitheLaw kChatters = describe<Chatters>("chatters");
inline constexpr LitheLaw kHammers = describe<Hammers>("hammers");
inline constexpr LitheLaw kSwings = describe<Swings>("swings");
inline constexpr LitheLaw kTuned = describe<Tuned>("tuned");
inline constexpr LitheLaw kClock = describe<Clock>("clock");
inline constexpr LitheLaw kRaise = describe<Raise>("raise");
inline constexpr LitheLaw kHuge = describe<Huge>("huge");
inline constexpr LitheLaw kFirst = describe<Beside<1>>("first");
inline constexpr LitheLaw kSecond = describe<Beside<2>>("second");
inline constexpr LitheLaw kPushesLater = describe<PushesLater>("pushes_later");
inline constexpr double kAllowedRad = 3 * step::Probation::kLeastErrorRad;  // where error_ratio is 3

class LawsTest : public TickTest {
 protected:
  std::vector<wire::Event> events(EventKind kind) {
    for (std::optional<wire::Event> event = next_event(); event; event = next_event()) all_.push_back(*event);
    std::vector<wire::Event> found;
    std::copy_if(all_.begin(), all_.end(), std::back_inserter(found),
                 [kind](const wire::Event& e) { return e.kind == static_cast<std::uint32_t>(kind); });
    return found;
  }
  std::optional<wire::Event> next_event() {
    wire::Event event{};
    if (!event_reader_.next(event)) return std::nullopt;
    return event;
  }
  std::optional<wire::LawFault> next_fault() {
    wire::LawFault fault{};
    if (!fault_reader_.next(fault)) return std::nullopt;
    return fault;
  }
  CommandResult set(std::uint32_t param, double value) {
    wire::Command command;
    command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
    command.count = 1;
    command.index[0] = param;
    command.value[0] = value;
    return send(command);
  }
  // Ticks with a Brain that is alive.
  void live(int count) {
    for (int i = 0; i < count; ++i) {
      brain_memory_->header.heartbeat_ns = now_ns_;
      tick();
    }
  }
  wire::ShadowReport shadow_report() const {
    wire::ShadowReport report{};
    ipc::ChannelReader<wire::ShadowReport>(memory_->shadow).read(report);
    return report;
  }

  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> event_reader_{memory_->events_tick};
  ipc::RingReader<wire::LawFault, wire::spine_segment::kLawFaultsDepth> fault_reader_{memory_->law_faults};
  std::vector<wire::Event> all_;
};

}  // namespace lithe::loop
