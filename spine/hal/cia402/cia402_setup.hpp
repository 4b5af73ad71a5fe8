// SPDX-License-Identifier: Apache-2.0
// Set-up of a CiA 402 drive before it may move: a list of SDO transfers.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::cia402 {

struct DriverParams {
  std::uint32_t id = 1;                 // 1 to 126
  std::uint32_t host_id = 127;          // whose heartbeat the drive watches
  double watchdog_s = 0.1;              // without that heartbeat for this long the drive quick-stops by itself
  double heartbeat_s = 0.1;             // of the drive's own
  double period_s = 0.001;              // between two commands
  std::uint32_t divider = 1;            // commanded in one of this many exchanges
  std::uint32_t lost_after_misses = 3;  // of its answers in a row
  Mode mode = Mode::torque;
  double counts_per_rev = 4096;  // of the motor; velocities are counts per second
  double rated_torque_nm = 1.0;  // of the motor, as its object 6076h must say too
  double torque_max_nm = 1.0;    // at the joint, as all below: the drive's own limit, object 6072h
  double torque_slew_nm_s = 1000.0;
  double velocity_max_rad_s = 20.0;
  double velocity_fault_rad_s = 25.0;  // beyond it the robot stops: the drive's own limit, object 607Fh
  double deceleration_rad_s2 = 20.0;
  double position_min_rad = 0.0;  // beyond these the robot stops: the drive's own limits, object 607Dh; equal: none
  double position_max_rad = 0.0;
  double target_min_rad = 0.0;  // of a position target; equal: none
  double target_max_rad = 0.0;
  double soft_start_s = 0.0;
  JointTransform joint{};
};

// Why a drive is not ready.
enum class NotReadyKind : std::uint8_t {
  none,
  not_booted,        // no boot-up message after a reset
  no_answer,         // to an SDO request; value: the abort code
  refused,           // an SDO request; value: the abort code
  not_a_drive,       // object 1000h names another profile; value: what it says
  mode_unsupported,  // object 6502h; value: what it says
  rated_torque,      // object 6076h is not what the robot file says; value: what it says [mNm]
  torque_limit,      // object 6072h allows more than torque_max_nm, and stays so; value: what it says [thousandths]
  mode_not_taken,    // object 6061h; value: what it says
  left_operational,  // the drive fell back by itself; value: its network state
  silent,            // no heartbeat
  unheard,           // no process data; value: commands without an answer
  left_enabled,      // it left `operation enabled` by itself, or ignores its target; value: its State
  not_enabled,       // it does not get there; value: its State
  velocity_unit,     // object 606Ch is not the rate of 6064h; value: 606Ch divided by that rate [thousandths]
};

using NotReadyReason = canopen::NotReady<NotReadyKind>;

// One sentence; empty for none. `params`: of the robot file that it does not fit.
// Contract: never in an exchange's thread
std::string describe(const NotReadyReason& not_ready, const DriverParams& params);
// The same with what it lacks beside that (Setup::lacking).
std::string told(const NotReadyReason& not_ready, const std::string& lacking, const DriverParams& params);

// The process data of a drive in each mode. Its answer is 6041h, 6064h and 6077h, which fill a frame of 8 bytes. The
// velocity is in a second frame: TPDO1, whose id has the higher priority. So the velocity of a SYNC is received before
// the answer to the same SYNC, and the answer counts also when the velocity was lost.
namespace pdo {
inline constexpr std::size_t kVelocity = 0;  // TPDO1
inline constexpr std::size_t kAnswer = 1;    // TPDO2

canopen::PdoMap command_map(Mode mode) LITHE_RT;  // RPDO1: control word, target, torque offset where there is one
canopen::PdoMap velocity_map() LITHE_RT;
canopen::PdoMap answer_map() LITHE_RT;
std::uint32_t command_id(std::uint32_t node) LITHE_RT;
std::uint32_t transmit_id(std::size_t number, std::uint32_t node) LITHE_RT;
}  // namespace pdo

// Executes the list, one transfer at a time. After the first refusal it writes nothing more; it only reads on, to learn
// which other objects the drive lacks.
// Contract: RT but for the constructor and lacking() · one thread, lacking() any · time is an argument
class Setup {
 public:
  explicit Setup(const DriverParams& params);

  enum class Progress : std::uint8_t { busy, done, failed };

  // `look`: reads what it would write, and changes nothing.
  void begin(canopen::SdoClient& client, bool look = false) LITHE_RT;
  // At most one frame. False: nothing to send now.
  bool next(std::int64_t now_ns, canopen::SdoClient& client, Frame& frame) LITHE_RT;
  // Call after the client has got an answer or aborted.
  Progress advance(canopen::SdoClient& client) LITHE_RT;
  const NotReadyReason& not_ready() const LITHE_RT { return not_ready_; }
  // The steps whose objects the drive lacks, a bit each; and those objects as text, but for this one.
  std::uint64_t lacks() const LITHE_RT { return lacks_; }
  std::string lacking(std::uint64_t lacks, std::uint16_t but_for) const;
  // A position drive keeps its target inside 607Dh: enabled beyond it, it would leap there. True: a set-up is needed
  // first; its 607Dh contains this position, or is that of the robot file again.
  bool must_move_limits(std::int32_t position_raw) LITHE_RT;

 private:
  enum class Kind : std::uint8_t {
    write,
    write_if_there,  // the drive may lack the object
    offer,           // and may refuse it
    require_profile,
    require_mode,
    require_rating,
    limit_torque,          // in thousandths of the rating that the drive reports; it may refuse this
    require_torque_limit,  // error when the drive allows more
    heartbeat,             // our heartbeat, not SDO
    start,                 // NMT, not SDO
    await_mode,
  };
  struct Step {
    Kind kind;
    canopen::Address address;
    std::uint32_t value;
    std::uint8_t bytes;
  };
  static constexpr std::size_t kMostSteps = 56;    // lacks_ has 64 bits
  static constexpr std::uint32_t kMostLooks = 50;  // reads of 6061h, until it shows the mode

  void add(Kind kind, std::uint16_t index, std::uint8_t subindex = 0, std::uint32_t value = 0, std::uint8_t bytes = 0);
  void add_safety(const DriverParams& params);
  void add_limits(const DriverParams& params);
  void add_interpolation(const DriverParams& params);
  void add_pdo(std::uint16_t communication, std::uint16_t mapping, std::uint32_t id, const canopen::PdoMap& map);
  bool judge(const Step& step, std::uint32_t value) LITHE_RT;
  bool refuse(NotReadyKind kind, const Step& step, std::uint32_t value) LITHE_RT;
  bool bear(const Step& step, std::uint32_t why) LITHE_RT;

  std::uint32_t node_;
  std::uint32_t host_;
  Mode mode_;
  double rated_mnm_;
  double motor_max_mnm_;            // of the motor
  std::uint32_t torque_limit_ = 0;  // the same in thousandths of the drive's own rating
  std::array<Step, kMostSteps> steps_{};
  std::size_t count_ = 0;
  std::size_t at_ = 0;
  std::size_t limits_at_ = 0;                  // the two steps of 607Dh; 0 = none
  std::int64_t least_raw_ = 0, most_raw_ = 0;  // of the robot file
  std::int64_t margin_raw_ = 0;
  std::uint32_t looks_ = 0;
  bool only_looks_ = false;
  std::uint64_t lacks_ = 0;
  NotReadyReason not_ready_;
};

}  // namespace lithe::hal::cia402
