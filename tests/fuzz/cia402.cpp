// SPDX-License-Identifier: Apache-2.0
// The CiA 402 driver fed with any frames between commands of any numbers, at any moment of its setup.
#include "spine/hal/cia402/cia402_drive.hpp"
#include "spine/hal/cia402/cia402_setpoint_limiter.hpp"
#include "spine/wire/wire.hpp"
#include "tests/fuzz/hal_input.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using namespace hal::cia402;
using canopen::NmtState;
namespace cob = canopen::cob;

constexpr std::uint32_t kNode = 5;
constexpr std::array<std::uint32_t, 7> kLikely{0x585, 0x705, 0x085, 0x185, 0x285, 0x586, 0x385};
constexpr std::int64_t kMs = 1'000'000;

DriverParams params_of(Input& input) {
  DriverParams params;
  params.id = kNode;
  params.joint = joint_of(input);
  const std::uint8_t choice = input.byte();
  constexpr std::array<Mode, 3> kModes{Mode::torque, Mode::velocity, Mode::position};
  constexpr std::array<double, 3> kCounts{4096, 1, 1e9};
  constexpr std::array<double, 3> kRated{1.27, 1e-9, 1e6};
  params.mode = kModes[choice % 3];
  params.counts_per_rev = kCounts[choice / 3 % 3];
  params.rated_torque_nm = kRated[choice / 9 % 3];
  return params;
}

// What a good drive says to a frame; nothing to one that needs no answer.
bool honest(const DriverParams& params, const Frame& sent, Frame& answer) {
  if (sent.id == cob::kNmt) {
    const bool start = sent.data[0] == 1;
    answer = canopen::heartbeat_frame(kNode, start ? NmtState::operational : NmtState::boot_up);
    return start || sent.data[0] == 0x81;
  }
  if (sent.id != cob::kSdoRequest + kNode) return false;
  const canopen::Address address = canopen::sdo_address(sent);
  answer = canopen::sdo_written_answer(kNode, address);
  if (sent.data[0] != 0x40) return true;
  std::uint32_t value = 0;
  if (address.index == 0x1000) value = 0x0002'0192;
  if (address.index == object::kSupportedModes) value = 0x380;
  if (address.index == object::kRatedTorque)
    value = static_cast<std::uint32_t>(std::lround(1000 * params.rated_torque_nm));
  if (address.index == object::kModeDisplay) value = static_cast<std::uint8_t>(params.mode);
  answer = canopen::sdo_read_answer(kNode, address, value, 4);
  return true;
}

class Bench {
 public:
  explicit Bench(const DriverParams& params) : params_(params), drive_(params) {}

  void command(const JointCommand& command, std::uint8_t ms) {
    ++exchange_.number;
    exchange_.now_ns += ms * kMs;
    exchange_.asked = false;
    outbox_.begin(0);
    const bool sound = drive_.command(command, exchange_, outbox_);
    require(sound == is_sound(command), "what is not finite is not sound");
    require(outbox_.sent().size() <= 2, "a driver sends two frames at most");
    for (const Frame& frame : outbox_.sent()) check_sent(frame, command, sound);
    exchange_.asked = true;
  }

  // A drive as it should be answers what was sent, so many exchanges long.
  void go_on(unsigned exchanges, const JointCommand& with) {
    for (unsigned i = 0; i < exchanges; ++i) {
      command(with, 1);
      Frame answer;
      for (const Frame& frame : outbox_.sent())
        if (honest(params_, frame, answer)) take(answer);
    }
  }

  void take(const Frame& frame) {
    JointSample untouched;
    untouched.position_rad = 0.125;
    untouched.status = 0x5a;
    JointSample sample = untouched;
    if (drive_.on_frame(frame, exchange_, sample) != ReplyKind::answer) {
      require(sample.position_rad == untouched.position_rad && sample.status == untouched.status && !sample.measured,
              "only an answer changes the sample");
      return;
    }
    require(exchange_.asked && drive_.running() && frame.id == pdo::transmit_id(pdo::kAnswer, kNode) &&
                canopen::is_canopen(frame),
            "an answer is the drive's process data, asked for, when it is set up");
    require((sample.status >> 16) < 8, "the state is one of the profile's");
    const double most_rev = 2147483648.0 / params_.counts_per_rev;
    if (sample.measured) check_measured(sample, params_.joint, most_rev, 10 * params_.rated_torque_nm);
  }

  void late() { exchange_.asked = false; }
  void says_why() const {
    require(drive_.running() || !drive_.why_not_ready().empty(), "a drive that is not ready says why");
  }

 private:
  void check_sent(const Frame& frame, const JointCommand& command, bool sound) const {
    require(canopen::is_canopen(frame), "what is sent is CANopen");
    const bool network = frame.id == cob::kNmt && frame.data[1] == kNode;
    const bool ours = frame.id == cob::kHeartbeat + params_.host_id;
    const bool to_it = frame.id == cob::kSdoRequest + kNode || frame.id == pdo::command_id(kNode);
    require(network || ours || to_it, "what is sent concerns this drive only");
    if (frame.id != pdo::command_id(kNode)) return;
    const std::uint32_t word = little_endian(frame.data.data(), 2);
    const bool drives = sound && command.action == DriveAction::torque;
    require(drives || word == control::kQuickStop || word == control::kDisableVoltage,
            "what is not sound, or not driving, enables nothing");
    const std::size_t at = params_.mode == Mode::torque ? 2 : 6;
    const double thousandths = canopen::signed_of(little_endian(frame.data.data() + at, 2), 2);
    const double limit = 1000 * std::max(command.max_torque_nm, 0.0) / params_.joint.ratio / params_.rated_torque_nm;
    require(thousandths == 0 || (drives && std::abs(thousandths) <= limit + 0.5),
            "no torque beyond the command's limit");
  }

  DriverParams params_;
  Cia402Drive drive_;
  Exchange exchange_;
  Outbox outbox_;
};

// Whatever is commanded one after the other: what the drive is told keeps to the joint's velocity, and to the torque.
void demands(const DriverParams& params, Input& input) {
  SetpointLimiter demand_of(params);
  const auto start = input.number<std::uint32_t>();
  demand_of.rest(start);
  const double per_rad = std::abs(params.joint.rev_per_rad()) * params.counts_per_rev;
  const double most_counts_s = per_rad * params.velocity_max_rad_s;
  double at = static_cast<std::int32_t>(start);
  JointSample last;
  for (int i = 0; i < 96 && !input.empty(); ++i) {
    JointCommand command = command_of(input);
    command.action = DriveAction::torque;
    last.position_rad = input.real();
    last.velocity_rad_s = input.real();
    if (!is_sound(command) || !std::isfinite(last.position_rad) || !std::isfinite(last.velocity_rad_s)) continue;
    const RawSetpoint raw = demand_of.next(command, last);
    const double target = static_cast<std::int32_t>(raw.target);
    const double limit_nm = std::clamp(command.max_torque_nm, 0.0, params.torque_max_nm);
    const double limit = 1000 * limit_nm / params.joint.ratio / params.rated_torque_nm + 0.5;
    const std::uint32_t torque = params.mode == Mode::torque ? raw.target : raw.torque;
    require(std::abs(canopen::signed_of(torque, 2)) <= limit, "no torque beyond the joint's, and the command's");
    if (params.mode == Mode::velocity) require(std::abs(target) <= most_counts_s + 1, "no speed beyond the joint's");
    if (params.mode != Mode::position) continue;
    require(std::abs(target - at) <= most_counts_s * params.period_s + 2, "no step beyond the joint's speed");
    at = target;
  }
}

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  const DriverParams params = params_of(input);
  if (input.byte() % 2 != 0) return demands(params, input);
  Bench bench(params);
  JointCommand command;
  for (int i = 0; i < 96 && !input.empty(); ++i) {
    const std::uint8_t what = input.byte();
    switch (what % 6) {
      case 0:
        command = command_of(input);
        bench.command(command, what / 6);
        break;
      case 1:
        bench.go_on(what / 6 * 2U, command);
        break;
      case 2:
        bench.late();
        break;
      default:
        bench.take(input.frame(kLikely, what % 6 == 3));
    }
  }
  bench.says_why();
}

std::vector<Seed> seeds() {
  std::vector<Seed> all;
  const auto tpdo2 = [](std::uint16_t word, std::uint32_t position, std::int16_t torque) {
    Frame frame = canopen::blank(0x285, 8);
    put_little_endian(frame.data.data(), word, 2);
    put_little_endian(frame.data.data() + 2, position, 4);
    put_little_endian(frame.data.data() + 6, static_cast<std::uint16_t>(torque), 2);
    return frame;
  };
  const auto tpdo1 = [](std::uint32_t velocity) {
    Frame frame = canopen::blank(0x185, 4);
    put_little_endian(frame.data.data(), velocity, 4);
    return frame;
  };
  for (unsigned kind = 0; kind < 27; ++kind) {
    Script script;
    script.byte(kind).byte(kind).byte(0).byte(1 + 6 * 40).byte(0 + 6 * 1);
    write(script, {{0.5, 0.25, 1, 10, 1}, DriveAction::torque, 2});
    for (const std::uint16_t word : List<std::uint16_t>{0x0240, 0x0221, 0x0223, 0x0227, 0x0227, 0x0208}) {
      script.byte(4).frame(tpdo1(1000)).byte(5).frame(tpdo2(word, 4096, 100)).byte(0 + 6 * 1);
      write(script, {{kSharp[kind % kSharp.size()], 0.25, 1, 10, 1}, DriveAction::torque, 2});
      script.byte(4).frame(tpdo1(0x7fffffff)).byte(5).frame(tpdo2(word, 0x80000000, -32768)).byte(0 + 6 * 1);
      write(script, {{0.5, kSharp[kind % kSharp.size()], 1, 10, 1}, DriveAction::torque, 2});
    }
    script.byte(4).frame(canopen::emergency_frame(kNode, {0x8130, 0x11}));
    script.byte(4).frame(canopen::heartbeat_frame(kNode, NmtState::pre_operational)).byte(1 + 6 * 40);
    script.byte(2).byte(5).frame(tpdo2(0x0227, 1, 1));
    all.push_back(script);
    Script path;
    path.byte(kind).byte(kind).byte(1).number(1000U);
    for (int i = 0; i < 48; ++i) {
      const double sharp = kSharp[static_cast<std::size_t>(i) / 3 % kSharp.size()];
      write(path, {{0.5, i % 2 == 0 ? sharp : 0.25, sharp, 10, 1}, DriveAction::torque, 2});
      path.real(0.1).real(0.2);
    }
    all.push_back(path);
  }
  return all;
}

}  // namespace lithe::fuzz
