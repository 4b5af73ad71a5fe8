// SPDX-License-Identifier: Apache-2.0
// How a simulated CiA 402 drive stops: told to, failing, or left alone.
#include "spine/hal/cia402/test/drive402_rig.hpp"

namespace lithe::hal::sim {
namespace {

TEST_F(Drive402, QuickStopEndsOffOrStaysAsItsOptionSays) {
  for (const std::uint16_t option : std::array<std::uint16_t, 2>{2, 6}) {
    write(0x605a, 0, option, 2);
    enable(9);
    write(0x60ff, 0, 20'000, 4);
    wait(200);
    EXPECT_NEAR(velocity(), 2 * kTurn, 0.1);
    control(0x02);
    wait(5);
    EXPECT_EQ(state(), State::quick_stop_active);
    EXPECT_GT(velocity(), 1);  // on a ramp
    wait(300);
    EXPECT_NEAR(velocity(), 0, kStands);
    EXPECT_EQ(state(), option == 2 ? State::switch_on_disabled : State::quick_stop_active);
    control(0x00);
    EXPECT_EQ(state(), State::switch_on_disabled);
  }
  write(0x605a, 0, 0, 2);  // no ramp: the power goes
  enable(9);
  control(0x02);
  EXPECT_EQ(state(), State::switch_on_disabled);
}

TEST_F(Drive402, AFaultSlowsDownStaysAndIsResetByARisingEdgeOnly) {
  enable(9);
  write(0x60ff, 0, 20'000, 4);
  wait(200);
  drive_.inject(canopen::emergency::kOverVoltage);
  const std::vector<Frame> news = wait(1);
  ASSERT_FALSE(news.empty());
  EXPECT_EQ(news[0].id, 0x085U);
  EXPECT_EQ(little_endian(news[0].data.data(), 2), 0x3210U);
  EXPECT_EQ(state(), State::fault_reaction_active);
  wait(500);
  EXPECT_EQ(state(), State::fault);
  EXPECT_NEAR(velocity(), 0, kStands);
  EXPECT_EQ(read(0x603f), 0x3210U);
  EXPECT_EQ(read(0x1001), 1U);
  control(0x00);
  control(0x80);
  EXPECT_EQ(state(), State::fault);  // its cause is still there
  drive_.inject(0);
  control(0x80);
  EXPECT_EQ(state(), State::fault);  // no edge
  control(0x00);
  const std::vector<Frame> reset = send(canopen::sdo_write_request(5, {0x6040, 0}, 0x80, 2));
  EXPECT_EQ(state(), State::switch_on_disabled);
  ASSERT_EQ(reset.size(), 2U);
  EXPECT_EQ(little_endian(reset[1].data.data(), 2), 0U);  // the emergency that takes the error back
  EXPECT_EQ(read(0x603f), 0U);
}

TEST_F(Drive402, AnInjectedFaultIsReportedByItsCode) {
  EXPECT_TRUE(drive_.inject(InjectedFault::over_temperature, true, now_ns_));
  EXPECT_EQ(little_endian(wait(1).at(0).data.data(), 2), 0x4210U);
  drive_.inject(InjectedFault::over_temperature, false, now_ns_);
  control(0x80);
  EXPECT_EQ(state(), State::switch_on_disabled);
  said();
  EXPECT_TRUE(drive_.inject(InjectedFault::encoder_lost, true, now_ns_));
  EXPECT_EQ(little_endian(wait(1).at(0).data.data(), 2), 0x7300U);
  EXPECT_TRUE(drive_.inject(InjectedFault::power_loss, true, now_ns_));
  EXPECT_TRUE(wait(90).empty());
  EXPECT_EQ(wait(20).at(0).id, 0x705U);
}

TEST_F(Drive402, ARestartHelpsAgainstNoCauseThatStays) {
  drive_.inject(InjectedFault::over_temperature, true, now_ns_);
  drive_.inject(InjectedFault::encoder_lost, true, now_ns_);
  nmt(NmtCommand::reset_node);
  EXPECT_FALSE(wait(10).empty());
  EXPECT_EQ(state(), State::fault);
  EXPECT_EQ(read(0x603f), 0x4210U);
  drive_.inject(InjectedFault::over_temperature, false, now_ns_);
  control(0x80);
  EXPECT_EQ(state(), State::fault) << "its encoder is still lost";
  control(0x00);
  drive_.inject(InjectedFault::encoder_lost, false, now_ns_);
  control(0x80);
  EXPECT_EQ(state(), State::switch_on_disabled);
}

TEST_F(Drive402, TakenTorqueIsNoFaultAndNotToBeEnabled) {
  enable(10);
  drive_.servo().set_torque_off(true);
  EXPECT_EQ(state(), State::switch_on_disabled);
  EXPECT_TRUE(said().empty());
  for (const std::uint16_t word : std::array<std::uint16_t, 3>{0x06, 0x07, 0x0f}) control(word);
  EXPECT_EQ(state(), State::switch_on_disabled);
  drive_.servo().set_torque_off(false);
  enable(10);
}

TEST_F(Drive402, ItsHeartbeatTellsItsState) {
  write(0x1017, 0, 20, 2);
  int beats = 0;
  for (const Frame& frame : wait(100)) {
    EXPECT_EQ(frame.id, 0x705U);
    EXPECT_EQ(frame.data[0], 0x7f);
    ++beats;
  }
  EXPECT_EQ(beats, 5);
  write(0x1017, 0, 0, 2);
  EXPECT_TRUE(wait(100).empty());
}

// What it does when no heartbeat comes any more, by object 6007h: 0 nothing, 1 fault, 2 power off, 3 quick stop.
TEST_F(Drive402, ALostHeartbeatDoesWhatItsOptionSays) {
  const std::array<State, 4> ends{State::operation_enabled, State::fault, State::switch_on_disabled,
                                  State::switch_on_disabled};
  for (std::uint16_t option = 0; option < 4; ++option) {
    nmt(NmtCommand::reset_node);
    wait(5);
    write(0x6007, 0, option, 2);
    write(0x1016, 1, 100U << 16 | 50, 4);
    nmt(NmtCommand::start);
    enable(9);
    write(0x60ff, 0, 10'000, 4);
    for (int i = 0; i < 20; ++i) {
      send(canopen::heartbeat_frame(100, NmtState::operational));
      send(canopen::heartbeat_frame(99, NmtState::operational));
      wait(10);
    }
    EXPECT_NEAR(velocity(), kTurn, 0.1);
    int emergencies = 0;
    for (const Frame& frame : wait(500)) {
      if (frame.id != 0x085) continue;
      EXPECT_EQ(little_endian(frame.data.data(), 2), 0x8130U);
      ++emergencies;
    }
    EXPECT_EQ(emergencies, 1) << option;
    EXPECT_EQ(state(), ends[option]) << option;
    EXPECT_EQ(drive_.network_state(), NmtState::pre_operational);
    EXPECT_EQ(read(0x1001), 0x11U);
  }
}

TEST_F(Drive402, TheStopHappensWhenTheTimeIsOverAlsoIfNobodyLooksThen) {
  write(0x1016, 1, 100U << 16 | 50, 4);
  write(0x6007, 0, 2, 2);
  enable(9);
  write(0x60ff, 0, 10'000, 4);
  send(canopen::heartbeat_frame(100, NmtState::operational));
  wait(40);
  now_ns_ += 10'000 * kMs;
  wait(1);
  EXPECT_EQ(state(), State::switch_on_disabled);
}

}  // namespace
}  // namespace lithe::hal::sim
