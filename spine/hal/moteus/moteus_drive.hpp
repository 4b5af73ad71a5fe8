// SPDX-License-Identifier: Apache-2.0
// Implements hal::Drive for a moteus.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/moteus_setup.hpp"

namespace lithe::hal::moteus {

// One command and one answer per exchange. With DriverParams::ask_settings its settings are read first (Setup): until
// then it answers, but is off and not ready. The settings are read again when it is off and was silent for a while: it
// may have been replaced.
// Contract: as hal::Drive; why_not_ready() any thread
class MoteusDrive final : public Drive {
 public:
  explicit MoteusDrive(const DriverParams& params);

  bool command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT override;
  ReplyKind take(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT override;
  std::string why_not_ready() const override { return describe_lack(not_ready_.load(std::memory_order_relaxed)); }

 private:
  static constexpr std::uint32_t kForgets = 10;  // exchanges without an answer

  bool ready() const LITHE_RT { return !asks_ || setup_.ready(); }
  // Relaxed: the word is self-contained. Pairs with why_not_ready().
  void tell() LITHE_RT { not_ready_.store(asks_ ? setup_.packed() : 0, std::memory_order_relaxed); }

  Driver driver_;
  const bool asks_;
  Setup setup_;
  bool asked_ = false;            // this exchange's frame contained a Setup question
  std::uint32_t unanswered_ = 0;  // exchanges in a row
  bool forgotten_ = false;        // it was silent for kForgets exchanges: read the settings again
  double velocity_rad_s_ = 0;     // last measured
  const double torque_step_nm_;
  double torque_allowed_nm_;                // its torque limit while it grows after calibration
  std::atomic<std::uint64_t> not_ready_{};  // Setup::packed(); stored by the exchange's thread, loaded by any
};

}  // namespace lithe::hal::moteus
