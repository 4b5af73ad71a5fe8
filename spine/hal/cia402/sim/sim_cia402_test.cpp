// SPDX-License-Identifier: Apache-2.0
// A simulated CiA 402 drive, asked frame by frame as any master would.
#include "spine/hal/cia402/sim/sim_cia402.hpp"

#include "spine/hal/cia402/test/drive402_rig.hpp"

namespace lithe::hal::sim {
namespace {

TEST_F(Drive402, BootsIntoPreOperationalAndSaysSo) {
  nmt(NmtCommand::reset_node);
  EXPECT_EQ(drive_.network_state(), NmtState::boot_up);
  EXPECT_TRUE(send(canopen::sdo_read_request(5, {0x1000, 0})).empty());  // not there yet
  const std::vector<Frame> frames = wait(5);
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].id, 0x705U);
  EXPECT_EQ(frames[0].data[0], 0);
  EXPECT_EQ(drive_.network_state(), NmtState::pre_operational);
  send(canopen::nmt_frame(NmtCommand::start, 6));  // somebody else
  EXPECT_EQ(drive_.network_state(), NmtState::pre_operational);
  send(canopen::nmt_frame(NmtCommand::start, 0));  // all
  EXPECT_EQ(drive_.network_state(), NmtState::operational);
  nmt(NmtCommand::stop);
  EXPECT_TRUE(send(canopen::sdo_read_request(5, {0x1000, 0})).empty());  // stopped: no SDO
  nmt(NmtCommand::enter_pre_operational);
  EXPECT_EQ(read(0x1000), 0x0002'0192U);
}

TEST_F(Drive402, EveryObjectOfTheProfileIsThere) {
  for (const std::uint32_t index :
       {0x1000, 0x1001, 0x1005, 0x1006, 0x1014, 0x1017, 0x6007, 0x603f, 0x6040, 0x6041, 0x605a,
        0x605b, 0x605c, 0x605d, 0x605e, 0x6060, 0x6061, 0x6064, 0x6065, 0x6066, 0x606c, 0x6071,
        0x6072, 0x6073, 0x6075, 0x6076, 0x6077, 0x6078, 0x6079, 0x607a, 0x607f, 0x6080, 0x6081,
        0x6083, 0x6084, 0x6085, 0x60b0, 0x60b1, 0x60b2, 0x60e0, 0x60e1, 0x60fd, 0x60ff, 0x6502}) {
    EXPECT_EQ(why_unread(static_cast<std::uint16_t>(index), 0), 0U) << std::hex << index;
  }
  for (const std::uint32_t index : {0x1016, 0x1018, 0x607d, 0x608f, 0x6091, 0x6092, 0x60c2, 0x60fe})
    EXPECT_EQ(why_unread(static_cast<std::uint16_t>(index), 1), 0U) << std::hex << index;
  EXPECT_EQ(read(0x6502), 0x380U);
  EXPECT_EQ(read(0x6076), 1000U);
  EXPECT_EQ(read_text(0x1008), "LITHE simulated CiA 402 drive");
}

TEST_F(Drive402, WhatCannotBeIsAbortedWithTheReasonOfTheStandard) {
  EXPECT_EQ(why_unread(0x2000, 0), abort_code::kNoObject);
  EXPECT_EQ(why_unread(0x1018, 9), abort_code::kNoSubindex);
  EXPECT_EQ(write(0x6041, 0, 0, 2), abort_code::kReadOnly);
  EXPECT_EQ(write(0x6040, 0, 0, 4), abort_code::kLength);
  EXPECT_EQ(write(0x6060, 0, 1, 1), abort_code::kValue);  // profile position is not simulated
  EXPECT_EQ(write(0x1008, 0, 0, 4), abort_code::kReadOnly);
  EXPECT_EQ(outcome(send(canopen::sdo_segment_request(5, false))), abort_code::kCommand);
  Frame block = canopen::sdo_read_request(5, {0x1000, 0});
  block.data[0] = 0xa0;
  EXPECT_EQ(outcome(send(block)), abort_code::kCommand);
  block.data[0] = 0x21;  // segmented download
  EXPECT_EQ(outcome(send(block)), abort_code::kCommand);
  send(canopen::sdo_read_request(5, {0x1008, 0}));
  EXPECT_EQ(outcome(send(canopen::sdo_segment_request(5, true))), abort_code::kToggle);
}

TEST_F(Drive402, MappingKeepsTheOrderOfTheStandard) {
  EXPECT_EQ(write(0x1a00, 0, 0, 1), abort_code::kState);  // it is on
  EXPECT_EQ(write(0x1800, 1, 0x8000'0185, 4), 0U);
  EXPECT_EQ(write(0x1a00, 1, 0x60640020, 4), abort_code::kUnsupportedAccess);  // its count is not 0
  EXPECT_EQ(write(0x1a00, 0, 0, 1), 0U);
  EXPECT_EQ(write(0x1a00, 1, 0x20000020, 4), 0U);
  EXPECT_EQ(write(0x1a00, 0, 1, 1), abort_code::kNotMappable);
  EXPECT_EQ(write(0x1a00, 1, 0x60640010, 4), 0U);
  EXPECT_EQ(write(0x1a00, 0, 1, 1), abort_code::kNotMappable);  // 16 bits of 32
  for (std::uint8_t i = 1; i <= 3; ++i) write(0x1a00, i, 0x60640020, 4);
  EXPECT_EQ(write(0x1a00, 0, 3, 1), abort_code::kPdoTooLong);
  EXPECT_EQ(write(0x1a00, 0, 9, 1), abort_code::kValue);
  EXPECT_EQ(write(0x1a00, 0, 2, 1), 0U);
  EXPECT_EQ(write(0x1800, 2, 2, 1), 0U);
  EXPECT_EQ(write(0x1800, 1, 0x2000'0185, 4), abort_code::kValue);  // 29 bits
  EXPECT_EQ(write(0x1800, 1, 0x185, 4), 0U);
  nmt(NmtCommand::start);
  EXPECT_TRUE(send(canopen::sync_frame()).empty());
  const std::vector<Frame> second = send(canopen::sync_frame());  // every second SYNC
  ASSERT_EQ(second.size(), 1U);
  EXPECT_EQ(second[0].id, 0x185U);
  EXPECT_EQ(second[0].size, 8);
}

TEST(Drive402Quirk, OneThatKnowsNoRemoteFramesRefusesAnIdThatAllowsThem) {
  SimCia402Params params;
  params.id = 5;
  params.knows_no_remote = true;
  SimCia402 drive(params);
  FrameQueue answers;
  drive.on_time(0, answers);
  drive.on_time(5 * kMs, answers);
  const auto outcome = [&](std::uint16_t index, std::uint32_t id) {
    answers.clear();
    drive.on_frame(canopen::sdo_write_request(5, {index, 1}, id, 4), 6 * kMs, answers);
    const Frame* answer = answers.front();
    return answer->data[0] == 0x80 ? little_endian(answer->data.data() + 4, 4) : 0;
  };
  EXPECT_EQ(outcome(0x1801, 0x8000'0285), abort_code::kValue);
  EXPECT_EQ(outcome(0x1801, 0xc000'0285), 0U);
  EXPECT_EQ(outcome(0x1401, 0x8000'0305), 0U);
}

TEST_F(Drive402, ByDefaultTheStatusIsSentWhenItChanges) {
  EXPECT_EQ(send(canopen::nmt_frame(NmtCommand::start, 5)).size(), 1U);
  EXPECT_TRUE(wait(10).empty());
  Frame shutdown = canopen::blank(0x205, 2);
  shutdown.data[0] = 0x06;
  const std::vector<Frame> frames = send(shutdown);  // RPDO1 of type 255: applied at once
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(frames[0].id, 0x185U);
  EXPECT_EQ(frames[0].data[0] & 0x6f, 0x21);
}

TEST_F(Drive402, TheStateMachineTakesNoShortCut) {
  EXPECT_EQ(state(), State::switch_on_disabled);
  control(0x0f);
  EXPECT_EQ(state(), State::switch_on_disabled);
  control(0x06);
  EXPECT_EQ(state(), State::ready_to_switch_on);
  control(0x0f);
  EXPECT_EQ(state(), State::switched_on);
  control(0x0f);
  EXPECT_EQ(state(), State::switched_on);  // without a mode there is nothing to enable
  write(0x6060, 0, 10, 1);
  control(0x0f);
  EXPECT_EQ(state(), State::operation_enabled);
  EXPECT_EQ(read(0x6061), 10U);
  control(0x07);
  EXPECT_EQ(state(), State::switched_on);
  control(0x06);
  EXPECT_EQ(state(), State::ready_to_switch_on);
  control(0x02);
  EXPECT_EQ(state(), State::switch_on_disabled);
}

TEST_F(Drive402, TorqueIsLimitedByEachOfItsObjects) {
  enable(10);
  write(0x6071, 0, 2500, 2);
  wait(5);
  EXPECT_NEAR(drive_.servo().plant().torque_nm(), 1.0, 1e-6);  // 6072h after power-on: the rated torque
  EXPECT_NE(read(0x6041) & cia402::status_bit::kLimited, 0U);
  write(0x6072, 0, 5000, 2);
  wait(5);
  EXPECT_NEAR(drive_.servo().plant().torque_nm(), 2.5, 1e-6);
  EXPECT_EQ(canopen::signed_of(read(0x6077), 2), 2500);
  write(0x60e0, 0, 300, 2);
  wait(5);
  EXPECT_NEAR(drive_.servo().plant().torque_nm(), 0.3, 1e-6);
  write(0x6071, 0, static_cast<std::uint16_t>(-2500), 2);
  wait(5);
  EXPECT_NEAR(drive_.servo().plant().torque_nm(), -2.5, 1e-6);
  write(0x60b2, 0, 500, 2);  // an offset adds to it
  wait(5);
  EXPECT_NEAR(drive_.servo().plant().torque_nm(), -2.0, 1e-6);
}

TEST_F(Drive402, ATargetThatWasNotPreloadedIsAJump) {
  drive_.servo().plant().place(0.1 * kTurn);
  enable(8);
  wait(300);
  EXPECT_NEAR(drive_.servo().plant().position_rad(), 0, 0.02);  // 607Ah was still 0
}

TEST_F(Drive402, PositionLimitsBindTheTarget) {
  write(0x607d, 1, static_cast<std::uint32_t>(-2000), 4);
  write(0x607d, 2, 1000, 4);
  enable(8);
  write(0x607a, 0, 9000, 4);
  nmt(NmtCommand::start);
  for (int i = 0; i < 500; ++i) {
    send(canopen::sync_frame());
    wait(1);
  }
  EXPECT_NEAR(drive_.servo().plant().position_rad() / kTurn, 0.1, 2e-3);
}

TEST_F(Drive402, ResetOfCommunicationKeepsTheDrivesOwnObjects) {
  write(0x6072, 0, 1234, 2);
  write(0x1017, 0, 20, 2);
  nmt(NmtCommand::reset_communication);
  wait(5);
  EXPECT_EQ(read(0x6072), 1234U);
  EXPECT_EQ(read(0x1017), 0U);
  nmt(NmtCommand::reset_node);
  wait(5);
  EXPECT_EQ(read(0x6072), 1000U);
}

TEST_F(Drive402, AShortProcessDataIsReportedAndNotTaken) {
  write(0x1400, 1, 0x8000'0205, 4);
  write(0x1600, 0, 0, 1);
  write(0x1600, 1, 0x60400010, 4);
  write(0x1600, 2, 0x60ff0020, 4);
  write(0x1600, 0, 2, 1);
  write(0x1400, 1, 0x205, 4);
  nmt(NmtCommand::start);
  wait(1);
  Frame shutdown = canopen::blank(0x205, 2);
  shutdown.data[0] = 0x06;
  const std::vector<Frame> frames = send(shutdown);
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_EQ(little_endian(frames[0].data.data(), 2), 0x8210U);
  EXPECT_EQ(state(), State::switch_on_disabled);
}

}  // namespace
}  // namespace lithe::hal::sim
