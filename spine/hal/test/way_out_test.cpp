// SPDX-License-Identifier: Apache-2.0
// Whatever state a driver has latched: off, reset (off with clear_fault) and on lead back to a drive that is driven, or
// the driver says why not.
#include <functional>
#include <string>

#include "spine/hal/cia402/test/cia402_line_rig.hpp"
#include "spine/hal/moteus/test/moteus_line_rig.hpp"

namespace lithe::hal {
namespace {

using cia402::State;
namespace bit = wire::joint_status;

class Cia402WayOut : public Cia402Line {
 public:
  // As `lithe reset` and `lithe arm`: the Spine says off with clear_fault for 200 ticks, then off, then torque.
  void reset_and_arm(int off_ms) {
    command_.clear_faults = true;
    act(DriveAction::off, 200);
    command_.clear_faults = false;
    act(DriveAction::off, off_ms);
    act(DriveAction::torque, 50);
  }
  bool driven() const { return fresh() && !has(bit::kFault) && drive_state() == State::operation_enabled; }
  bool may_be_armed() const { return fresh() && !has(bit::kNotReady); }
  void deafen(std::uint32_t id) {
    cables_[0]->back = [id](Frame& frame) { return frame.id != id; };
  }
  // The watch on its heartbeat sends what is not sent any more until the drive has been reset.
  void stop_beating() {
    FrameQueue unheard;
    drive().on_frame(canopen::sdo_write_request(1, {0x1017, 0}, 0, 2), now_ns_, unheard);
  }
  void mend() {
    cables_[0]->there = cables_[0]->back = [](Frame&) { return true; };
  }
  std::string why() const { return drivers_[0]->why_not_ready(); }
  auto& sim() { return drive(); }
  auto& cable() { return *cables_[0]; }
  void pass(int ms) { cycle(ms); }
  std::int64_t now_ns() const { return now_ns_; }
  void torque(double nm) { command_.torque_nm[0] = nm; }
};

// How a state is latched, and how its cause goes away.
struct Latched {
  const char* name;
  std::function<void(Cia402WayOut&)> begin;
  std::function<void(Cia402WayOut&)> end = [](Cia402WayOut& line) { line.mend(); };
  int off_ms = 6500;  // between reset and arm; a drive is reset once in 5 s
  double velocity_unit = 1;
};

class Cia402Latches : public Cia402WayOut, public testing::WithParamInterface<Latched> {};

TEST_P(Cia402Latches, HaveAWayOut) {
  const Latched& state = GetParam();
  build({.velocity_unit = state.velocity_unit});
  enable();
  ASSERT_TRUE(driven()) << state.name;
  state.begin(*this);
  EXPECT_FALSE(driven()) << state.name;
  state.end(*this);
  cycle(100);
  EXPECT_FALSE(driven()) << state.name << ": it does not start by itself";
  reset_and_arm(state.off_ms);
  EXPECT_TRUE(driven()) << state.name << ": " << why();
  EXPECT_EQ(why(), "") << state.name;
}

INSTANTIATE_TEST_SUITE_P(
    Drives, Cia402Latches,
    testing::Values(Latched{"no heartbeat for a while",
                            [](Cia402WayOut& line) {
                              line.deafen(0x701);
                              line.pass(500);
                            }},
                    Latched{"no heartbeat until it is told again to beat",
                            [](Cia402WayOut& line) {
                              line.stop_beating();
                              line.pass(5000);
                            }},
                    Latched{"no answers",
                            [](Cia402WayOut& line) {
                              line.deafen(0x281);
                              line.pass(50);
                            }},
                    Latched{"nothing at all for a while",
                            [](Cia402WayOut& line) {
                              line.cable().there = line.cable().back = [](Frame&) { return false; };
                              line.pass(1500);
                            }},
                    Latched{"a fault whose cause goes away",
                            [](Cia402WayOut& line) {
                              line.sim().inject(InjectedFault::over_temperature, true, line.now_ns());
                              line.pass(50);
                            },
                            [](Cia402WayOut& line) {
                              line.sim().inject(InjectedFault::over_temperature, false, line.now_ns());
                            }},
                    Latched{"for it, its host was silent",
                            [](Cia402WayOut& line) {
                              line.sim().inject(InjectedFault::watchdog_trip, true, line.now_ns());
                              line.pass(300);
                            }},
                    Latched{"its torque was taken away and given back",
                            [](Cia402WayOut& line) {
                              line.sim().servo().set_torque_off(true);
                              line.pass(50);
                            },
                            [](Cia402WayOut& line) { line.sim().servo().set_torque_off(false); }},
                    Latched{"a restart",
                            [](Cia402WayOut& line) {
                              line.sim().inject(InjectedFault::power_loss, true, line.now_ns());
                              line.pass(300);
                            }},
                    Latched{"refused at the set-up after a restart",
                            [](Cia402WayOut& line) {
                              line.cable().back = [](Frame& frame) {
                                const canopen::Address at = canopen::sdo_address(frame);
                                if (frame.id == 0x581 && at.index == 0x6007)
                                  frame = canopen::sdo_abort(0x581, at, canopen::abort_code::kState);
                                return true;
                              };
                              line.sim().inject(InjectedFault::power_loss, true, line.now_ns());
                              line.pass(1500);
                            }},
                    // Seen as if the drive told turns per minute, until somebody sets it right.
                    Latched{"a velocity that is not that of its position", [](Cia402WayOut& line) {
                              line.cable().back = [](Frame& frame) {
                                if (frame.id == 0x181) put_little_endian(frame.data.data(), 1, 4);
                                return true;
                              };
                              line.torque(0.3);
                              line.pass(1500);
                              line.torque(0);
                            }}));

class Cia402Silence : public Cia402WayOut {};

// The resets are bounded, and it is not armed meanwhile: the words of why are those of `arm`.
TEST_F(Cia402Silence, ThatDoesNotEndIsNamedAndNotArmed) {
  build();
  enable();
  int resets = 0;
  cables_[0]->there = [&resets](Frame& frame) {
    resets += frame.id == 0 && frame.data[0] == 0x81;
    return true;
  };
  cables_[0]->back = [](Frame& frame) { return frame.id != 0x701 || frame.data[0] == 0; };  // but for its boot-up
  cycle(500);
  EXPECT_TRUE(has(bit::kFault));
  EXPECT_EQ(resets, 0) << "while it drives it is not reset";
  int armable = 0;
  for (int ms = 0; ms < 20'000; ++ms) {
    act(DriveAction::off);
    armable += may_be_armed();
  }
  EXPECT_EQ(armable, 0);
  EXPECT_GE(resets, 2);
  EXPECT_LE(resets, 5);
  EXPECT_NE(why().find("no heartbeat (1017h)"), std::string::npos) << why();
  mend();
  reset_and_arm(6500);
  EXPECT_TRUE(driven()) << why();
}

// A watch of 0.3 s against a heartbeat that was a moment late.
TEST_F(Cia402Silence, ThatWasShortIsForgivenWithoutAReset) {
  build();
  enable();
  int resets = 0;
  cables_[0]->there = [&resets](Frame& frame) {
    resets += frame.id == 0 && frame.data[0] == 0x81;
    return true;
  };
  deafen(0x701);
  cycle(350);
  act(DriveAction::off, 100);
  mend();
  cycle(150);
  act(DriveAction::torque, 50);
  EXPECT_TRUE(driven()) << why();
  EXPECT_EQ(resets, 0);
}

// A moteus latches its own fault and timeout, and its driver what will not do in its settings.
struct MoteusLatched {
  const char* name;
  std::function<void(MoteusLine&)> begin;
  std::function<void(MoteusLine&)> end = [](MoteusLine& line) { line.node.back = nullptr; };
};

TEST(MoteusWayOut, EveryLatchedStateHasOne) {
  const MoteusLatched all[] = {
      {"a fault whose cause goes away",
       [](MoteusLine& line) { line.node.drive().inject(InjectedFault::over_temperature, true, line.now_ns); },
       [](MoteusLine& line) { line.node.drive().inject(InjectedFault::over_temperature, false, line.now_ns); }},
      {"for it, its host was silent",
       [](MoteusLine& line) { line.node.drive().inject(InjectedFault::watchdog_trip, true, line.now_ns); }},
      {"a restart", [](MoteusLine& line) { line.node.drive().inject(InjectedFault::power_loss, true, line.now_ns); }},
      {"nothing at all for a while", [](MoteusLine& line) { line.node.back = [](Frame&) LITHE_RT { return false; }; }},
      {"a setting that will not do, and is mended",
       [](MoteusLine& line) {
         line.tell("conf set servo.timeout_mode 0");
         line.node.back = [](Frame&) LITHE_RT { return false; };  // it was away, and is asked again
       },
       [](MoteusLine& line) {
         line.node.back = nullptr;
         line.act(DriveAction::off, 200);
         EXPECT_NE(line.moteus->why_not_ready().find("timeout_mode"), std::string::npos);
         line.tell("conf set servo.timeout_mode 12");
       }},
  };
  for (const MoteusLatched& state : all) {
    MoteusLine line(MoteusLine::asking());
    line.act(DriveAction::off, 50);
    line.act(DriveAction::torque, 50);
    ASSERT_EQ(line.mode(), 10U) << state.name;
    state.begin(line);
    line.cycle(300);
    state.end(line);
    line.command.clear_faults = true;
    line.act(DriveAction::off, 200);
    line.command.clear_faults = false;
    line.act(DriveAction::off, 1500);
    EXPECT_TRUE(line.ready()) << state.name << ": " << line.moteus->why_not_ready();
    line.act(DriveAction::torque, 50);
    EXPECT_EQ(line.mode(), 10U) << state.name;
    EXPECT_FALSE(line.has(bit::kFault)) << state.name;
  }
}

}  // namespace
}  // namespace lithe::hal
