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
#include "spine/hal/bus/frame.hpp"
#include "spine/hal/device/moteus_codec.hpp"

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
  gain,          // one of its own gains is 0: nothing can be scaled
  limp,          // its watchdog would let go of the joint
};

// One question per exchange, beside the usual ones, while the drive is off: the register map, then settings through the
// console. An answer that is lost is asked for again, and so, now and then, is one that will not do: somebody may have
// mended it. What it says of others' questions is thrown away.
// Contract: RT but for describe() · one thread · bounded
class Setup {
 public:
  // The answer may be as long as this beside the usual 24 bytes.
  static constexpr std::uint32_t kMostBytes = 32;

  void restart() LITHE_RT;
  bool ready() const LITHE_RT { return question_ == kQuestions; }
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
  static constexpr std::uint32_t kPatience = 200;  // exchanges for an answer
  static constexpr std::uint32_t kRest = 1000;     // and before it is asked again what it could not answer

  void take_register_map(const Subframe& reply) LITHE_RT;
  void take_text(const Subframe& data) LITHE_RT;
  void take_line() LITHE_RT;
  void answered(double value) LITHE_RT;
  void refuse(Lack lack, double value) LITHE_RT;
  void next() LITHE_RT;

  Settings settings_;
  std::size_t question_ = 0;
  Phase phase_ = Phase::empty;
  std::uint32_t exchanges_ = 0;  // in this phase
  Lack lack_ = Lack::silent;
  std::uint8_t lacking_ = 0;  // the question it is about
  float value_ = 0;           // the answer that will not do
  std::array<char, 48> line_{};
  std::size_t length_ = 0;
  bool too_long_ = false;
};

// Of Setup::packed(), in words with what to do; empty for none.
std::string describe_lack(std::uint64_t packed);

}  // namespace lithe::hal::moteus
