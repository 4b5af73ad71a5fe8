// SPDX-License-Identifier: Apache-2.0
// Frames of a simulated moteus; its registers are in moteus_registers.cpp.
#include "spine/hal/moteus/sim/sim_moteus.hpp"

#include <algorithm>
#include <array>
#include <utility>

#include "spine/hal/physics/truth.hpp"

namespace lithe::hal::sim {

using moteus::kBroadcast;
using moteus::Kind;
using moteus::kReplyRequested;
using moteus::Subframe;
using moteus::SubframeReader;
using moteus::SubframeWriter;

namespace {

constexpr std::uint32_t kConsoleChannel = 1;

std::uint32_t drawn(Draws& draws) { return static_cast<std::uint32_t>(draws.next() >> 32); }

}  // namespace

MoteusIdentity MoteusIdentity::of(std::uint64_t serial) {
  MoteusIdentity identity;
  Draws draws(serial);
  for (std::uint32_t& word : identity.serial) word = drawn(draws);
  for (std::uint8_t& byte : identity.uuid) byte = static_cast<std::uint8_t>(drawn(draws));
  identity.uuid[6] = static_cast<std::uint8_t>((identity.uuid[6] & 0x0f) | 0x40);  // version 4: random
  identity.uuid[8] = static_cast<std::uint8_t>((identity.uuid[8] & 0x3f) | 0x80);
  return identity;
}

std::int32_t MoteusIdentity::uuid_word(std::size_t word) const LITHE_RT {
  return static_cast<std::int32_t>(little_endian(uuid.data() + 4 * word, 4));
}

void SimMoteus::restart(std::int64_t back_ns) LITHE_RT {
  inside_.config.load();
  ServoParams params = inside_.servo.params();
  inside_.config.act_on(params);
  inside_.servo.restart(params);
  command_ = ServoCommand{};
  gpio_ = {};
  pwm_ = {};
  clock_trim_ = 0;
  console_.restart();
  deaf_until_ns_ = back_ns;
}

bool SimMoteus::inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT {
  constexpr std::int64_t kBootNs = 100'000'000;
  constexpr double kTooHotC = 20;  // above the fault's threshold
  constexpr double kRoomC = 25;
  Servo& servo = inside_.servo;
  if (injected == InjectedFault::power_loss && begins) restart(now_ns + kBootNs);
  if (injected == InjectedFault::watchdog_trip && begins) servo.expire_watchdog();
  if (injected == InjectedFault::over_temperature)
    servo.set_temperature_c(begins ? servo.params().fault_temperature_c + kTooHotC : kRoomC);
  if (injected == InjectedFault::encoder_lost) servo.set_encoder_lost(begins);
  if (injected == InjectedFault::device_fault) servo.set_driver_failed(begins);
  if (injected == InjectedFault::homing_lost) homed_ = !begins;
  if (injected == InjectedFault::other_map) other_map_ = begins;
  return true;
}

void SimMoteus::on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT {
  const std::uint32_t id = inside_.config.id();
  const std::uint32_t destination = frame.id & 0xff;
  if (frame.id >> 16 != inside_.config.prefix() || (destination != id && destination != kBroadcast)) return;
  inside_.servo.advance(now_ns);
  if (now_ns < deaf_until_ns_) return;
  Frame answer;
  commanded_ = discarded_ = false;
  const bool speaks = serve(frame, answer);
  if (commanded_ && !discarded_) inside_.servo.apply(commanded_mode_, command_);
  if (!speaks || discarded_ || (frame.id & kReplyRequested) == 0) return;
  answer.id = inside_.config.prefix() << 16 | id << 8 | ((frame.id >> 8) & 0x7f);
  answer.extended = answer.id > kLargestStandardId;
  answer.fd = frame.fd || answer.size > 8;
  answer.brs = frame.brs && answer.fd;
  answers.push(answer);
}

// False: the frame is not answered.
bool SimMoteus::serve(const Frame& request, Frame& answer) LITHE_RT {
  SubframeWriter writer(answer);
  SubframeReader reader(request.payload());
  Subframe subframe;
  bool going = true;
  while (going && reader.next(subframe)) {
    if (subframe.kind == Kind::flow) return false;
    const bool streams = subframe.kind == Kind::client_data || subframe.kind == Kind::poll;
    if (streams) stream(subframe, writer);
    going = streams;  // what only a drive sends is not for a drive
    if (subframe.kind == Kind::write) going = write(subframe, writer);
    if (subframe.kind == Kind::read) going = read(subframe, writer);
  }
  writer.pad();
  // The maker's library fails on an empty answer, so padding is sent instead.
  if (answer.size == 0) {
    answer.data[0] = 0x50;
    answer.size = 1;
  }
  return true;
}

bool SimMoteus::write(const Subframe& subframe, SubframeWriter& answer) LITHE_RT {
  for (std::uint32_t i = 0; i < subframe.count && !discarded_; ++i) {
    const std::uint32_t number = subframe.start + i;
    const Access access = write_register(number, subframe.value(i));
    if (access != Access::done) answer.error(Kind::write_error, number, static_cast<std::uint32_t>(access));
  }
  return !discarded_;
}

bool SimMoteus::read(const Subframe& subframe, SubframeWriter& answer) LITHE_RT {
  std::array<double, kMaxPayload> values{};
  if (subframe.count > values.size()) return false;  // more than fits a frame
  for (std::uint32_t i = 0; i < subframe.count; ++i) {
    const std::uint32_t number = subframe.start + i;
    const std::optional<double> value = read_register(number, subframe.format);
    if (!value) answer.error(Kind::read_error, number, static_cast<std::uint32_t>(Access::unknown));
    if (!value) return false;
    values[i] = *value;
  }
  constexpr std::uint32_t kMoved = 0x40;
  const std::uint32_t start = subframe.start + (other_map_ ? kMoved : 0);
  answer.reply(subframe.format, start, {values.data(), subframe.count}, subframe.long_form);
  return answer.ok();
}

void SimMoteus::stream(const Subframe& subframe, SubframeWriter& answer) LITHE_RT {
  std::array<std::uint8_t, kMaxPayload> bytes{};
  const bool console = subframe.start == kConsoleChannel;
  if (subframe.kind == Kind::client_data) {
    if (console) console_.feed({subframe.data, subframe.count}, inside_);
    return answer.server_data(subframe.start, {});
  }
  constexpr std::size_t kHead = 3;  // kind, channel, length
  const std::size_t room = answer.room() > kHead ? answer.room() - kHead : 0;
  const std::size_t most = std::min<std::size_t>(subframe.count, room);
  const std::size_t count = console ? console_.fetch({bytes.data(), most}, inside_) : 0;
  answer.server_data(subframe.start, {bytes.data(), count});
}

SimDevice make_sim_moteus(const SimPlace& place) {
  SimMoteusParams params;
  params.id = place.device.id;
  params.serial = place.index + 1;
  params.joint = place.joint;
  params.servo.encoder_counts = place.encoder_counts;
  params.plant = place.plant;
  params.errors = place.errors;
  auto node = std::make_unique<SimMoteus>(params);
  CoupledDrive& drive = node->servo();
  return {std::move(node), &drive};
}

double moteus_torque_max_nm(const robot::DeviceConfig& /*device*/) { return ServoParams{}.motor_torque_max_nm; }

}  // namespace lithe::hal::sim
