// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/cia402/cia402_setup.hpp"

namespace lithe::hal::cia402 {
namespace {

TEST(Cia402, EveryStateIsToldByItsMaskWhateverTheOtherBitsAre) {
  const std::map<std::uint16_t, State> words{{0x0000, State::not_ready},
                                             {0x0250, State::switch_on_disabled},
                                             {0x0231, State::ready_to_switch_on},
                                             {0x0233, State::switched_on},
                                             {0x1637, State::operation_enabled},
                                             {0x0617, State::quick_stop_active},
                                             {0x022f, State::fault_reaction_active},
                                             {0x0218, State::fault},
                                             {0x0238, State::fault},
                                             {0x0270, State::switch_on_disabled}};
  for (const auto& [word, expected] : words) {
    State state{};
    ASSERT_TRUE(decode_state(word, state)) << std::hex << word;
    EXPECT_EQ(state, expected) << std::hex << word;
  }
  State state = State::fault;
  for (const std::uint16_t word : std::array<std::uint16_t, 5>{0x0001, 0x0003, 0x0005, 0x0048, 0x004f})
    EXPECT_FALSE(decode_state(word, state)) << std::hex << word;
  EXPECT_EQ(state, State::fault);
}

TEST(Cia402, AStateThatIsEncodedIsDecodedAgain) {
  for (std::uint8_t i = 0; i < 8; ++i) {
    State state{};
    ASSERT_TRUE(decode_state(encode_state(static_cast<State>(i)), state));
    EXPECT_EQ(state, static_cast<State>(i));
    EXPECT_FALSE(state_name(state).empty());
  }
}

TEST(Cia402, TheWayToEnabledIsThreeWordsAndNoneLeavesAFault) {
  EXPECT_EQ(control_to_enable(State::switch_on_disabled), 0x06);
  EXPECT_EQ(control_to_enable(State::ready_to_switch_on), 0x07);
  EXPECT_EQ(control_to_enable(State::switched_on), 0x0f);
  EXPECT_EQ(control_to_enable(State::operation_enabled), 0x0f);
  for (const State state : {State::not_ready, State::quick_stop_active, State::fault_reaction_active, State::fault})
    EXPECT_EQ(control_to_enable(state), 0x00);
}

TEST(Cia402, CommandsFitOneFrameInEveryMode) {
  EXPECT_EQ(pdo::command_map(Mode::torque).bytes(), 4U);
  EXPECT_EQ(pdo::command_map(Mode::position).bytes(), 8U);
  EXPECT_EQ(pdo::command_map(Mode::velocity).bytes(), 8U);
  EXPECT_EQ(pdo::answer_map().bytes(), 8U);
  EXPECT_EQ(pdo::command_id(5), 0x205U);
  EXPECT_EQ(pdo::transmit_id(pdo::kVelocity, 5), 0x185U);
  EXPECT_EQ(pdo::transmit_id(pdo::kAnswer, 5), 0x285U);
}

TEST(Cia402, ANotReadyReasonSurvivesItsWordAndSaysWhatToDo) {
  const NotReadyReason not_ready{NotReadyKind::refused, {0x6007, 2}, 0x06020000};
  const NotReadyReason same = NotReadyReason::unpacked(not_ready.packed());
  EXPECT_EQ(same.kind, not_ready.kind);
  EXPECT_EQ(same.address, not_ready.address);
  EXPECT_EQ(same.value, not_ready.value);
  EXPECT_EQ(
      describe(same, {}),
      "object 6007h:02 is refused with abort 0x06020000 (no such object); the drive lacks what LITHE needs of it");
  EXPECT_EQ(describe({}, {}), "");
  for (std::uint8_t kind = 1; kind <= static_cast<std::uint8_t>(NotReadyKind::velocity_unit); ++kind)
    EXPECT_FALSE(describe({static_cast<NotReadyKind>(kind), {}, 0}, {}).empty());
}

bool is_request(const Frame& frame) { return canopen::function_of(frame) == canopen::cob::kSdoRequest; }

// Everything a drive is told, by a drive that agrees with all.
std::vector<Frame> told(const DriverParams& params) {
  canopen::SdoClient client(params.id);
  Setup setup(params);
  setup.begin(client);
  std::vector<Frame> frames;
  std::map<std::uint16_t, std::uint32_t> readable{
      {0x1000, 0x00020192}, {0x6502, 0x380}, {0x6076, 1000}, {0x6061, static_cast<std::uint8_t>(params.mode)}};
  for (int i = 0; i < 500; ++i) {
    if (setup.advance(client) != Setup::Progress::busy) break;
    Frame frame;
    if (!setup.next(0, client, frame)) continue;
    frames.push_back(frame);
    if (!is_request(frame)) continue;
    const canopen::Address address = canopen::sdo_address(frame);
    if (address.index == 0x6072 && frame.data[0] != 0x40) readable[0x6072] = little_endian(frame.data.data() + 4, 2);
    const auto value = readable.find(address.index);
    client.on_frame(value != readable.end() && frame.data[0] == 0x40
                        ? canopen::sdo_read_answer(params.id, address, value->second, 4)
                        : canopen::sdo_written_answer(params.id, address));
  }
  EXPECT_EQ(setup.advance(client), Setup::Progress::done);
  return frames;
}

std::uint32_t written(const std::vector<Frame>& frames, std::uint16_t index, std::uint8_t subindex) {
  std::uint32_t value = 0xdead;
  for (const Frame& frame : frames) {
    const bool write = is_request(frame) && (frame.data[0] & 0xe0) == 0x20;
    if (write && canopen::sdo_address(frame) == canopen::Address{index, subindex})
      value = little_endian(frame.data.data() + 4, canopen::sdo_expedited_bytes(frame.data[0]));
  }
  return value;
}

TEST(Cia402Setup, TheDriveWatchesAndHasHeardUsBeforeItIsStartedAndGetsItsModeAfter) {
  const std::vector<Frame> frames = told({});
  std::size_t watch = 0, beat = 0, start = 0, mode = 0;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (frames[i].id == 0) start = i;
    if (frames[i].id == 0x77f) beat = i;
    if (is_request(frames[i]) && canopen::sdo_address(frames[i]).index == 0x1016) watch = i;
    if (is_request(frames[i]) && canopen::sdo_address(frames[i]).index == 0x6060) mode = i;
  }
  EXPECT_LT(watch, beat);
  EXPECT_LT(beat, start);
  EXPECT_LT(start, mode);
  EXPECT_LT(frames.size(), 48U);
}

TEST(Cia402Setup, AMotorThatStillTurnsIsStoppedFirst) {
  const std::vector<Frame> frames = told({});
  EXPECT_EQ(canopen::sdo_address(frames.at(1)), (canopen::Address{0x6040, 0}));
  EXPECT_EQ(written(frames, 0x6040, 0), 0x02U);
}

// Bit 30: no remote frames. Where process data is received it means nothing, and must not be there.
TEST(Cia402Setup, IdsOfSentProcessDataSayThatNobodyAsksForIt) {
  const std::vector<Frame> frames = told({.id = 5});
  EXPECT_EQ(written(frames, 0x1800, 1), 0x4000'0185U);
  EXPECT_EQ(written(frames, 0x1801, 1), 0x4000'0285U);
  EXPECT_EQ(written(frames, 0x1802, 1), 0xc000'0385U);
  EXPECT_EQ(written(frames, 0x1400, 1), 0x205U);
}

TEST(Cia402Setup, WhereItsOwnLoopMovesTheJointTheDriveGetsItsLimits) {
  DriverParams params{.id = 1, .mode = Mode::position, .counts_per_rev = 1000};
  params.position_min_rad = -1;
  params.position_max_rad = 2;
  params.velocity_fault_rad_s = 3;
  params.joint = {-1.0, 0.0, 10.0};
  const double counts_per_rad = 10 * 1000 / 6.283185307;
  std::vector<Frame> frames = told(params);
  EXPECT_NEAR(canopen::signed_of(written(frames, 0x607d, 1), 4), -2 * counts_per_rad, 1);
  EXPECT_NEAR(canopen::signed_of(written(frames, 0x607d, 2), 4), counts_per_rad, 1);
  EXPECT_NEAR(written(frames, 0x607f, 0), 3 * counts_per_rad, 1);
  params.mode = Mode::torque;
  frames = told(params);
  EXPECT_EQ(written(frames, 0x607d, 1), 0xdeadU);
  EXPECT_EQ(written(frames, 0x607f, 0), 0xdeadU);
}

TEST(Cia402Setup, AProcessDataIsOffWhileItIsMapped) {
  std::vector<std::string> order;
  for (const Frame& frame : told({})) {
    const canopen::Address address = canopen::sdo_address(frame);
    if (!is_request(frame) || (address.index != 0x1801 && address.index != 0x1a01)) continue;
    const bool off = (little_endian(frame.data.data() + 4, 4) & canopen::cob::kOff) != 0;
    order.push_back(address.index == 0x1a01 ? "map" + std::to_string(address.subindex)
                    : address.subindex == 2 ? "type"
                    : off                   ? "off"
                                            : "on");
  }
  EXPECT_EQ(order, (std::vector<std::string>{"off", "map0", "map1", "map2", "map3", "map0", "type", "on"}));
}

TEST(Cia402Setup, PeriodsAreSaidAsAByteTimesAPowerOfTen) {
  const auto said = [](double period_s) {
    DriverParams params;
    params.period_s = period_s;
    const std::vector<Frame> frames = told(params);
    return std::pair{written(frames, 0x60c2, 1),
                     static_cast<int>(static_cast<std::int8_t>(written(frames, 0x60c2, 2)))};
  };
  EXPECT_EQ(said(0.001), (std::pair{1U, -3}));
  EXPECT_EQ(said(0.002), (std::pair{2U, -3}));
  EXPECT_EQ(said(0.01), (std::pair{1U, -2}));
  EXPECT_EQ(said(0.0005), (std::pair{5U, -4}));
  EXPECT_EQ(said(0.0001), (std::pair{1U, -4}));
  EXPECT_EQ(said(1.0 / 300), (std::pair{33U, -4}));  // the nearest that fits in a byte
}

TEST(Cia402Setup, LimitsAndTimesAreInTheDrivesUnits) {
  DriverParams params;
  params.torque_max_nm = 12;
  params.joint.ratio = 50;
  params.rated_torque_nm = 1;
  params.watchdog_s = 0.05;
  params.host_id = 100;
  const std::vector<Frame> frames = told(params);
  EXPECT_EQ(written(frames, 0x6072, 0), 240U);
  EXPECT_EQ(written(frames, 0x1016, 1), 100U << 16 | 50U);
  EXPECT_EQ(written(frames, 0x1017, 0), 100U);
  EXPECT_EQ(written(frames, 0x6007, 0), 3U);
  EXPECT_EQ(written(frames, 0x605a, 0), 2U);
}

}  // namespace
}  // namespace lithe::hal::cia402
