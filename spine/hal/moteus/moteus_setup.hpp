// SPDX-License-Identifier: Apache-2.0
// Set-up check of a moteus before it may be commanded: register map, gains, watchdog action.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {

struct Settings {
  double kp_nm_rev = 0;
  double kd_nm_s_rev = 0;
  double rotor_to_output_ratio = std::numeric_limits<double>::quiet_NaN();  // NaN: the firmware has no such setting
};

// Why a drive may not be commanded.
enum class NotReady : std::uint8_t {
  none,
  silent,        // no answer yet
  register_map,  // its register map is another one
  unsaid,        // the console's answer is not a number
  gain,          // one of its gains is 0 or implausible, so it cannot be scaled
  limp,          // after a watchdog timeout it would let the joint go limp
  holds,         // after a watchdog timeout it would go on with its own gains, and the robot file does not permit that
  weak,          // one of its gains is smaller than needed with integer formats
  setting,       // a setting that commands leave to the drive is wrong
  too_strong,    // its timeout damping exceeds the joint's torque limit and cannot be changed
};

// Additional requirements when frames leave settings out or use integer formats.
struct Expected {
  double least_kp_nm_rev = 0;
  double least_kd_nm_s_rev = 0;
  bool may_hold = false;  // after a watchdog timeout
  bool settings = false;  // watchdog time, no planner, no integral are the drive's own
  double watchdog_s = 0.1;
  // At the motor: a larger damping torque after a timeout is reduced to this, with that console line.
  double damp_torque_max_nm = std::numeric_limits<double>::infinity();
  std::array<char, 64> damp_line{};
  std::size_t damp_line_length = 0;
};

// One question per exchange, beside the usual ones, while the drive is off: the register map, then settings through the
// console. A lost answer is asked for again; so is, from time to time, an unsuitable one, because the setting may have
// been corrected. Answers to other clients are ignored.
// Contract: RT but for describe() · one thread · bounded
class Setup {
 public:
  // Largest answer, in addition to the usual 24 bytes.
  static constexpr std::uint32_t kMostBytes = 32;

  explicit Setup(const Expected& expected = {}) : expected_(expected) {}

  void restart() LITHE_RT { *this = Setup(expected_); }
  bool ready() const LITHE_RT { return question_ == (expected_.settings ? kAllQuestions : kQuestions); }
  const Settings& settings() const LITHE_RT { return settings_; }
  NotReady not_ready() const LITHE_RT { return not_ready_; }

  // Appends this exchange's question.
  void ask(SubframeWriter& writer) LITHE_RT;
  // The complete answer to it.
  void on_frame(const Frame& answer) LITHE_RT;
  // There was no answer.
  void missed() LITHE_RT;

  // The reason packed into one word, for another thread.
  std::uint64_t packed() const LITHE_RT;

 private:
  enum class Phase : std::uint8_t { empty, say, listen, rest };

  static constexpr std::size_t kQuestions = 6;
  static constexpr std::size_t kAllQuestions = 10;  // including settings that commands leave out
  static constexpr std::uint32_t kPatience = 200;   // longest wait for an answer, in exchanges
  static constexpr std::uint32_t kRest = 1000;      // pause before an unsuitable answer is asked for again

  void on_register_map(const Subframe& reply) LITHE_RT;
  void on_text(const Subframe& data) LITHE_RT;
  void on_line() LITHE_RT;
  void answered(double value) LITHE_RT;
  void answered_gain(double value, double least, double& gain) LITHE_RT;
  void limit_damping(double value) LITHE_RT;
  void refuse(NotReady not_ready, double value) LITHE_RT;
  void next() LITHE_RT;

  Expected expected_;
  Settings settings_;
  std::size_t question_ = 0;
  Phase phase_ = Phase::empty;
  std::uint32_t exchanges_ = 0;  // in this phase
  NotReady not_ready_ = NotReady::silent;
  std::uint8_t unanswered_question_ = 0;    // index of the question
  float value_ = 0;                         // the unsuitable answer
  bool setting_ = false, was_set_ = false;  // of the damping
  std::array<char, 48> line_{};
  std::size_t length_ = 0;
  bool too_long_ = false;
};

// Text of Setup::packed() with the next step; empty for none.
std::string describe_not_ready(std::uint64_t packed);

}  // namespace lithe::hal::moteus
