// SPDX-License-Identifier: Apache-2.0
// What a moteus must have said about itself before it may be commanded: its registers, its gains, what its watchdog
// does.
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
  double rotor_to_output_ratio = std::numeric_limits<double>::quiet_NaN();  // NaN: firmware that has no such setting
};

// Why a drive may not be commanded.
enum class Lack : std::uint8_t {
  none,
  silent,        // it has said nothing yet
  register_map,  // its registers mean something else
  unsaid,        // it does not answer a question with a number
  gain,          // one of its own gains is 0, or no gain of any motor: nothing can be scaled
  limp,          // its watchdog would let go of the joint
  weak,          // one of its own gains is less than whole numbers in a command would have to ask for
  setting,       // a setting that commands leave to the drive is not as the robot needs it
  too_strong,    // alone it would damp with more than the joint's torque limit, and does not take another setting
};

// What else must be so where a robot's frames leave something out, or say it in whole numbers.
struct Expected {
  double least_kp_nm_rev = 0;
  double least_kd_nm_s_rev = 0;
  bool settings = false;  // watchdog time, no planner, no integral are the drive's own
  double watchdog_s = 0.1;
  // At the motor: one that would damp with more when it is left alone is told to damp with this, by that line.
  double damp_torque_max_nm = std::numeric_limits<double>::infinity();
  std::array<char, 64> damp_line{};
  std::size_t damp_line_length = 0;
};

// One question per exchange, beside the usual ones, while the drive is off: the register map, then settings through the
// console. An answer that is lost is asked for again, and so, now and then, is one that will not do: somebody may have
// mended it. What it says of others' questions is thrown away.
// Contract: RT but for describe() · one thread · bounded
class Setup {
 public:
  // The answer may be as long as this beside the usual 24 bytes.
  static constexpr std::uint32_t kMostBytes = 32;

  explicit Setup(const Expected& expected = {}) : expected_(expected) {}

  void restart() LITHE_RT;
  bool ready() const LITHE_RT { return question_ == (expected_.settings ? kAllQuestions : kQuestions); }
  const Settings& settings() const LITHE_RT { return settings_; }
  Lack lack() const LITHE_RT { return lack_; }

  // Appends this exchange's question.
  void ask(SubframeWriter& writer) LITHE_RT;
  // The answer to it, whole.
  void take(const Frame& answer) LITHE_RT;
  // There was none.
  void missed() LITHE_RT;

  // All of the trouble in one word, for another thread.
  std::uint64_t packed() const LITHE_RT;

 private:
  enum class Phase : std::uint8_t { empty, say, listen, rest };

  static constexpr std::size_t kQuestions = 6;
  static constexpr std::size_t kAllQuestions = 10;  // with those about settings that commands leave out
  static constexpr std::uint32_t kPatience = 200;   // exchanges for an answer
  static constexpr std::uint32_t kRest = 1000;      // and before it is asked again what it could not answer

  void take_register_map(const Subframe& reply) LITHE_RT;
  void take_text(const Subframe& data) LITHE_RT;
  void take_line() LITHE_RT;
  void answered(double value) LITHE_RT;
  void answered_gain(double value, double least, double& gain) LITHE_RT;
  void limit_damping(double value) LITHE_RT;
  void refuse(Lack lack, double value) LITHE_RT;
  void next() LITHE_RT;

  Expected expected_;
  Settings settings_;
  std::size_t question_ = 0;
  Phase phase_ = Phase::empty;
  std::uint32_t exchanges_ = 0;  // in this phase
  Lack lack_ = Lack::silent;
  std::uint8_t lacking_ = 0;                // the question it is about
  float value_ = 0;                         // the answer that will not do
  bool setting_ = false, was_set_ = false;  // of the damping
  std::array<char, 48> line_{};
  std::size_t length_ = 0;
  bool too_long_ = false;
};

// Of Setup::packed(), in words with what to do; empty for none.
std::string describe_lack(std::uint64_t packed);

}  // namespace lithe::hal::moteus
