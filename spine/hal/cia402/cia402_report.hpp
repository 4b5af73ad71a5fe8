// SPDX-License-Identifier: Apache-2.0
// Values of a CiA 402 drive that are not in its process data: read by SDO, one every 50 ms.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/core/drive.hpp"

namespace lithe::hal::cia402 {

// Objects 6075h (rated current, once), then 6078h (current) and 6079h (supply) in turn, each ten times a second. All
// three are optional in the profile: one that the drive does not have is not asked for again, and its value stays NaN.
// The profile has no object for temperature or power. SDO frames have lower priority than process data on the bus.
// Contract: RT · one thread · shares the client: asks only while it is free
class ReportClient {
 public:
  static constexpr std::int64_t kPauseNs = 50'000'000;

  // Everything is unknown again.
  void restart() LITHE_RT { *this = ReportClient(); }
  void ask(std::int64_t now_ns, canopen::SdoClient& sdo) LITHE_RT;
  // The client has finished a transfer. False: it was not one of ours.
  bool on_answer(const canopen::SdoClient& sdo) LITHE_RT;

  // Of the motor; the sign of the joint is the caller's.
  double current_a() const LITHE_RT;
  double voltage_v() const LITHE_RT { return voltage_v_; }

 private:
  static constexpr std::array<std::uint16_t, 3> kQuestions{object::kRatedCurrent, object::kCurrent, object::kSupply};

  std::size_t question_ = 0;
  std::array<bool, kQuestions.size()> settled_{};  // not to be asked again
  bool asked_before_ = false;
  std::int64_t next_ns_ = 0;
  double rated_a_ = DriveReport::kNotReported;
  double current_share_ = DriveReport::kNotReported;  // of the rated current
  double voltage_v_ = DriveReport::kNotReported;
};

}  // namespace lithe::hal::cia402
