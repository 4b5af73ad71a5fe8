// SPDX-License-Identifier: Apache-2.0
// moteus: any frame into the driver, any command out of it, any bytes through the subframe reader and back.
#include "spine/hal/moteus/moteus.hpp"

#include <string>

#include "spine/hal/moteus/moteus_terminal.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"
#include "spine/wire/wire.hpp"
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
  const std::uint8_t formats = input.byte(), how = input.byte();
  params.ask_settings = (how & 1) != 0;
  if ((how & 2) != 0) params.damp_kd_nm_s_rad = 0.5;
  if ((how & 4) != 0) params.torque_step_nm = 0.1;
  if ((how & 8) != 0) params.velocity_max_rad_s = 20;
  const auto format = [&](unsigned shift) { return static_cast<Format>(formats >> shift & 3); };
  params.frames = {.command = format(2), .answer = format(0)};
  return params;
}

// Subframes lie inside the payload, whatever it claims; and what they say can be said again.
void walk(const Frame& frame) {
  const Bytes payload = frame.payload();
  SubframeReader reader(payload);
  Subframe s;
  std::size_t subframes = 0;
  while (reader.next(s)) {
    require(++subframes <= payload.size(), "at most one subframe per byte");
    if (s.data == nullptr) continue;
    const bool values = s.kind == Kind::write || s.kind == Kind::reply;
    const std::size_t bytes = s.count * (values ? bytes_of(s.format) : 1);
    require(s.data >= payload.data() && s.data + bytes <= payload.data() + payload.size(), "values lie in the frame");
    for (std::uint32_t i = 0; values && i < s.count; ++i) {
      const double value = s.value(i);
      std::array<std::uint8_t, 4> again{};
      encode_value(value, quantity_of(s.start + i), s.format, again.data());
      const double back = decode_value(again.data(), quantity_of(s.start + i), s.format);
      // Towards zero: one count may be lost, and none is won.
      const double count = count_worth(quantity_of(s.start + i), s.format);
      const bool close = std::abs(back) <= std::abs(value) && std::abs(back - value) <= 1.001 * count;
      require(back == value || (std::isnan(value) && std::isnan(back)) || (s.format != Format::float32 && close),
              "a value is written as it was read");
    }
  }
  Found found;
  if (parse_discovery(frame, found)) require(found.id >= 1 && found.id <= 126, "a drive that is found has an address");
}

// No number leaves that is none, but for a position that is not meant.
void check_sent(const Frame& frame, bool driven) {
  require(is_can(frame), "a command is a frame that CAN has");
  SubframeReader reader(frame.payload());
  Subframe s;
  bool torque = false;
  while (reader.next(s)) {
    for (std::uint32_t i = 0; s.kind == Kind::write && i < s.count; ++i) {
      const std::uint32_t number = s.start + i;
      const double value = s.value(i);
      const bool position = number == reg::kCommandPosition;
      require(std::isfinite(value) || (position && std::isnan(value)), "no number leaves that is not finite");
      torque |= number != reg::kMode && number != reg::kKdScale;
    }
  }
  require(reader.well_formed(), "a command is well-formed");
  require(driven || !torque, "what is not sound is damped and nothing else");
}

void one_command(const MoteusDrive& driver, const JointCommand& command, Input& input) {
  Frame frame;
  const bool sound = driver.encode(command, input.byte(), frame);
  require(sound <= is_sound(command), "what is not finite is not sound");
  check_sent(frame, sound && command.action == DriveAction::torque);
}

// The driver in its exchanges: questions first, if it asks any, then commands.
class Bench {
 public:
  explicit Bench(const DriverParams& params) : params_(params), drive_(params), device_(device_params(params)) {}

  void command(const JointCommand& command) {
    ++exchange_.number;
    exchange_.now_ns += 1'000'000;
    exchange_.source = exchange_.number % 8;
    exchange_.asked = false;
    outbox_.begin(0);
    const bool sound = drive_.command(command, exchange_, outbox_);
    require(outbox_.sent().size() == 1, "one command in one exchange");
    check_sent(outbox_.sent()[0], sound && is_sound(command) && command.action == DriveAction::torque);
    exchange_.asked = true;
  }

  // A drive as it should be answers, so many exchanges long.
  void go_on(unsigned exchanges, const JointCommand& with) {
    for (unsigned i = 0; i < exchanges; ++i) {
      command(with);
      device_.on_frame(outbox_.sent()[0], exchange_.now_ns, said_);
      for (; const Frame* answer = said_.front(); said_.pop()) take(*answer);
    }
  }

  void take(Frame frame, bool to_us = false) {
    if (to_us) frame.id = kId << 8 | exchange_.source;
    walk(frame);
    JointSample untouched;
    untouched.position_rad = 0.125;
    untouched.status = 0x5a;
    JointSample sample = untouched;
    if (drive_.on_frame(frame, exchange_, sample) != ReplyKind::answer) {
      require(sample.position_rad == untouched.position_rad && sample.status == untouched.status && !sample.measured,
              "only an answer changes the sample");
      return;
    }
    require(exchange_.asked && (frame.id >> 8) == kId && (frame.id & 0xff) == exchange_.source,
            "an answer is to us, from it");
    if (sample.measured) check_measured(sample, params_.joint, kMotorRev, kMotorNm);
    require(((sample.status & wire::joint_status::kNotReady) != 0) == !drive_.why_not_ready().empty(),
            "a drive that is not ready says why");
  }

  // What its console says, beside a whole answer.
  void says(std::string_view words) {
    Frame frame;
    frame.id = kId << 8;
    frame.fd = frame.brs = true;
    SubframeWriter writer(frame);
    writer.reply(Format::int8, reg::kMode, std::array{0.0}, false);
    writer.reply(Format::float32, reg::kPosition, std::array{0.0, 0.0, 0.0}, false);
    writer.reply(Format::int8, reg::kHomeState, std::array{2.0, 24.0, 30.0, 0.0}, true);
    writer.server_data(1, {reinterpret_cast<const std::uint8_t*>(words.data()), words.size()});
    writer.pad();
    take(frame, true);
  }
  void late() { exchange_.asked = false; }

 private:
  static sim::SimMoteusParams device_params(const DriverParams& params) {
    sim::SimMoteusParams device;
    device.id = kId;
    device.joint = params.joint;
    return device;
  }

  DriverParams params_;
  MoteusDrive drive_;
  sim::SimMoteus device_;
  Exchange exchange_;
  Outbox outbox_;
  FrameQueue said_;
};

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  const DriverParams params = params_of(input);
  Bench bench(params);
  const MoteusDrive driver(params);
  JointCommand command;
  for (int i = 0; i < 64 && !input.empty(); ++i) {
    const std::uint8_t what = input.byte();
    switch (what % 8) {
      case 0:
        one_command(driver, command_of(input), input);
        break;
      case 1:
        command = command_of(input);
        bench.command(command);
        break;
      case 2:
        bench.go_on(what / 8, command);
        break;
      case 3:
        bench.command(command);
        bench.says(input.text(what / 8));
        break;
      case 4:
        bench.late();
        break;
      default:
        bench.take(input.frame(kLikely, true), what % 8 != 5);
    }
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
    script.byte(joint).byte(joint % 2 != 0 ? 0xff : 0x15).byte(joint * 2);
    script.byte(1);
    write(script, {{0.5, 0.25, 1, 10, 1}, DriveAction::torque, 2});
    for (const double value : kSharp) {
      for (const Format format : {Format::float32, Format::int16}) {
        script.byte(6).frame(answer(format, 0.25, 1, value, 10));
        script.byte(6).frame(answer(format, value, 1, 0.1, 10));
        script.byte(7).frame(answer(format, 0.25, value, 0.1, 11));
      }
    }
    all.push_back(script);
    for (const double value : kSharp) {
      Script commands;
      commands.byte(joint).byte(0xc + joint).byte(2 + 4 * joint);  // as floats: no format hides what is sent
      for (double JointCommand::* field : kFields) {
        JointCommand command{{0.5, 0.25, 1, 10, 1}, DriveAction::torque, 2};
        command.*field = value;
        commands.byte(0);
        write(commands, command);
        commands.byte(0).real(-0.5).real(field == kFields[0] ? value : 0.5).byte(1);
      }
      if (joint < 2) all.push_back(commands);
    }
  }
  // Asked how it is set, it says what it likes; then it is commanded.
  for (const std::string_view number : {"4.0", "0", "-1", "nan", "inf", "1e-300", "1e300", "1e-30", "12", "ERR", ""}) {
    Script asked;
    asked.byte(6).byte(0xff).byte(3).byte(1);
    write(asked, {{0.5, 0.25, 1, 10, 1}, DriveAction::torque, 2});
    for (int question = 0; question < 6; ++question) {
      asked.byte(2 + 8 * (question == 0 ? 4 : 1));
      const std::string words = std::string(number) + "\r\n";
      asked.byte(3 + 8 * static_cast<unsigned>(words.size())).text(words);
    }
    asked.byte(2 + 8 * 31).byte(1);
    write(asked, {{0.5, 0.25, 1, 10, 1}, DriveAction::torque, 2});
    all.push_back(asked);
  }
  Frame discovery;
  make_discovery(discovery);
  all.push_back(Script().byte(0).byte(0xff).byte(0).byte(5).frame(discovery));
  return all;
}

}  // namespace lithe::fuzz
