// SPDX-License-Identifier: Apache-2.0
// What a drive does by itself, nobody commanding it, has no more torque than the joint may have.
#include <algorithm>
#include <cmath>
#include <string>

#include "spine/hal/cia402/test/cia402_line_rig.hpp"

namespace lithe::hal {
namespace {

using cia402::Mode;

class Cia402TorqueLimit : public Cia402Line {};

// A drive may say that its rating is up to 5 % more than the robot file's: its limit counts in thousandths of its own.
TEST_F(Cia402TorqueLimit, HoldsInTheQuickStopWhenTheHostDies) {
  build({.mode = Mode::velocity, .rated_torque_nm = 0.52});
  enable();
  FrameQueue unheard;  // a ramp that asks for more than the limit
  drive().on_frame(canopen::sdo_write_request(1, {0x6085, 0}, 65536 * 1000, 4), now_ns_, unheard);
  command_.velocity_rad_s[0] = 15;
  cycle(2000);
  ASSERT_GT(plant().velocity_rad_s(), 14);
  double most_nm = 0;
  for (int ms = 0; ms < 700; ++ms) {
    silence(1);
    most_nm = std::max(most_nm, std::abs(plant().torque_nm()));
  }
  EXPECT_NEAR(plant().velocity_rad_s(), 0, 0.1);
  EXPECT_GT(most_nm, 3.8) << "the limit is what held it";
  EXPECT_LE(most_nm, 4.0) << "torque_max_nm";
}

// What a drive says to a write of 6072h, and what it holds then.
struct Answer {
  const char* what;
  std::uint32_t to_write;  // an abort; 0: yes
  std::uint32_t to_read;   // likewise
  std::uint32_t holds;     // thousandths; 800 are torque_max_nm
  const char* why;         // it is not ready; "" = it is
};

class Cia402TorqueLimits : public Cia402TorqueLimit, public testing::WithParamInterface<Answer> {};

TEST_P(Cia402TorqueLimits, ThatCannotBeSetAreReadAndChecked) {
  const Answer& says = GetParam();
  build();
  cables_[0]->back = [&says](Frame& frame) {
    if (frame.id != 0x581 || canopen::sdo_address(frame).index != 0x6072) return true;
    const canopen::Address at = canopen::sdo_address(frame);
    const bool written = frame.data[0] == 0x60;
    const std::uint32_t abort = written ? says.to_write : says.to_read;
    if (abort != 0)
      frame = canopen::sdo_abort(0x581, at, abort);
    else if (!written)
      frame = canopen::sdo_read_answer(1, at, says.holds, 2);
    return true;
  };
  act(DriveAction::off, 300);
  const std::string why = drivers_[0]->why_not_ready();
  EXPECT_EQ(drivers_[0]->running(), *says.why == '\0') << says.what << ": " << why;
  EXPECT_NE(why.find(says.why), std::string::npos) << says.what << ": " << why;
  EXPECT_EQ(why.empty(), *says.why == '\0') << says.what << ": " << why;
}

INSTANTIATE_TEST_SUITE_P(
    Drives, Cia402TorqueLimits,
    testing::Values(Answer{"read-only, low enough", canopen::abort_code::kReadOnly, 0, 700, ""},
                    Answer{"read-only, too high", canopen::abort_code::kReadOnly, 0, 1000, "6072h:00 = 1000"},
                    Answer{"taken, but not kept", 0, 0, 1000, "is more than torque_max_nm"},
                    Answer{"not there", canopen::abort_code::kNoObject, canopen::abort_code::kNoObject, 0,
                           "nothing keeps what the drive does by itself"}));

}  // namespace
}  // namespace lithe::hal
