// SPDX-License-Identifier: Apache-2.0
// moteus: any frame into the driver, any command out of it, any bytes through the subframe reader and back.
#include "spine/hal/device/moteus.hpp"

#include "spine/hal/device/moteus_drive.hpp"
#include "spine/hal/device/moteus_terminal.hpp"
#include "tests/fuzz/hal_input.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using namespace hal::moteus;

constexpr std::uint32_t kId = 3;
constexpr double kMotorNm = 1000;
constexpr std::array<std::uint32_t, 6> kLikely{kId << 8, kId << 8 | 5,    4 << 8,
                                               0x8003,   kId << 8 | 0x80, 0x10000 | kId << 8};

DriverParams params_of(Input& input) {
  DriverParams params;
  params.id = kId;
  params.joint = joint_of(input);
  const std::uint8_t formats = input.byte();
  const auto format = [&](unsigned shift) { return static_cast<Format>(formats >> shift & 3); };
  params.answer = {format(0), format(2), format(4)};
  params.command.position = format(1);
  params.command.torque = format(3);
  params.command.kp_scale = format(5);
  params.command.watchdog = format(6);
  return params;
}

// Subframes lie inside the payload, whatever it claims; and what they say can be said again.
void walk(const Frame& frame) {
  const Bytes payload = frame.payload();
  SubframeReader reader(payload);
  Subframe s;
  std::size_t subframes = 0;
  while (reader.next(s)) {
    demand(++subframes <= payload.size(), "at most one subframe per byte");
    if (s.data == nullptr) continue;
    const bool values = s.kind == Kind::write || s.kind == Kind::reply;
    const std::size_t bytes = s.count * (values ? bytes_of(s.format) : 1);
    demand(s.data >= payload.data() && s.data + bytes <= payload.data() + payload.size(), "values lie in the frame");
    for (std::uint32_t i = 0; values && i < s.count; ++i) {
      const double value = s.value(i);
      std::array<std::uint8_t, 4> again{};
      encode_value(value, quantity_of(s.start + i), s.format, again.data());
      const double back = decode_value(again.data(), quantity_of(s.start + i), s.format);
      // Towards zero: one count may be lost, and none is won.
      const double count = count_worth(quantity_of(s.start + i), s.format);
      const bool close = std::abs(back) <= std::abs(value) && std::abs(back - value) <= 1.001 * count;
      demand(back == value || (std::isnan(value) && std::isnan(back)) || (s.format != Format::float32 && close),
             "a value is written as it was read");
    }
  }
  Found found;
  if (take_discovery(frame, found)) demand(found.id >= 1 && found.id <= 126, "a drive that is found has an address");
}

// No number leaves that is none, but for a position that is not meant.
void check_sent(const Frame& frame, bool driven) {
  demand(is_can(frame), "a command is a frame that CAN has");
  SubframeReader reader(frame.payload());
  Subframe s;
  bool torque = false;
  while (reader.next(s)) {
    for (std::uint32_t i = 0; s.kind == Kind::write && i < s.count; ++i) {
      const std::uint32_t number = s.start + i;
      const double value = s.value(i);
      const bool position = number == reg::kCommandPosition || number == reg::kLowerBound || number == reg::kUpperBound;
      demand(std::isfinite(value) || (position && std::isnan(value)), "no number leaves that is not finite");
      torque |= number != reg::kMode;
    }
  }
  demand(reader.well_formed(), "a command is well-formed");
  demand(driven || !torque, "what is not sound is damped and nothing else");
}

void one_command(const Driver& driver, const JointCommand& command, Input& input) {
  Frame frame;
  const bool sound = driver.encode(command, input.byte(), frame);
  demand(sound <= is_sound(command), "what is not finite is not sound");
  check_sent(frame, sound && command.action == DriveAction::torque);
  const double lower_rad = input.real(), upper_rad = input.real();
  const bool within = driver.encode_within(command, lower_rad, upper_rad, input.byte(), frame);
  check_sent(frame, within);
}

void one_answer(MoteusDrive& drive, const DriverParams& params, const Frame& frame, Exchange& exchange) {
  JointSample untouched;
  untouched.position_rad = 0.125;
  untouched.status = 0x5a;
  JointSample sample = untouched;
  const Heard heard = drive.take(frame, exchange, sample);
  if (heard != Heard::answer) {
    demand(sample.position_rad == untouched.position_rad && sample.status == untouched.status && !sample.measured,
           "only an answer changes the sample");
    return;
  }
  demand(exchange.asked && (frame.id >> 8) == kId && (frame.id & 0xff) == exchange.source,
         "an answer is to us, from it");
  if (sample.measured) check_measured(sample, params.joint, kMotorRev, kMotorNm);
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  const DriverParams params = params_of(input);
  MoteusDrive drive(params);
  const Driver driver(params);
  Exchange exchange;
  exchange.asked = true;
  for (int i = 0; i < 64 && !input.empty(); ++i) {
    const std::uint8_t what = input.byte();
    if (what % 4 == 0) {
      one_command(driver, command_of(input), input);
      continue;
    }
    exchange.asked = what % 4 != 3;
    exchange.source = what / 4 % 8;
    const Frame frame = input.frame(kLikely, true);
    walk(frame);
    one_answer(drive, params, frame, exchange);
  }
}

std::vector<Seed> seeds() {
  std::vector<Seed> all;
  const auto answer = [](Format format, double position_rev, double velocity_rev_s, double torque_nm, double mode) {
    Frame frame;
    frame.id = kId << 8;
    frame.fd = frame.brs = true;
    SubframeWriter writer(frame);
    writer.reply(Format::int8, reg::kMode, std::array{mode}, false);
    writer.reply(format, reg::kPosition, std::array{position_rev, velocity_rev_s, torque_nm}, false);
    writer.reply(Format::int8, reg::kHomeState, std::array{2.0, 24.0, 30.0, 0.0}, true);
    writer.pad();
    return frame;
  };
  for (unsigned joint = 0; joint < 8; ++joint) {
    Script script;
    script.byte(joint).byte(joint % 2 != 0 ? 0xff : 0x15);
    for (const double value : kSharp) {
      for (const Format format : {Format::float32, Format::int16}) {
        script.byte(1).frame(answer(format, 0.25, 1, value, 10));
        script.byte(1).frame(answer(format, value, 1, 0.1, 10));
        script.byte(2).frame(answer(format, 0.25, value, 0.1, 11));
      }
    }
    all.push_back(script);
    for (const double value : kSharp) {
      Script commands;
      commands.byte(joint).byte(joint);
      for (double JointCommand::* field : kFields) {
        JointCommand command{DriveAction::torque, 0.5, 0.25, 1, 10, 1, 2};
        command.*field = value;
        commands.byte(0);
        write(commands, command);
        commands.byte(0).real(-0.5).real(field == kFields[0] ? value : 0.5).byte(1);
      }
      if (joint < 2) all.push_back(commands);
    }
  }
  Frame discovery;
  make_discovery(discovery);
  all.push_back(Script().byte(0).byte(0xff).byte(1).frame(discovery));
  return all;
}

}  // namespace lithe::fuzz
