// SPDX-License-Identifier: Apache-2.0
// A simulated moteus: any frames, any words for its console, any pauses. Whoever speaks with it meets a drive.
#include "spine/hal/moteus/sim/sim_moteus.hpp"

#include <cmath>
#include <string>

#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using namespace hal::moteus;

constexpr std::uint32_t kId = 3;
constexpr std::array<std::uint32_t, 6> kLikely{0x8000 | kId, kId, 0x807f, 0x007f, 0x8500 | kId, 0x8004};
constexpr int kMostFrames = 96;
constexpr std::int64_t kMostNs = 400'000'000;  // of simulated time in one input

class Bench {
 public:
  Bench() : drive_(params()) { drive_.on_time(now_ns_, said_); }

  void pass(std::int64_t ns) {
    spent_ns_ += ns;
    now_ns_ += spent_ns_ < kMostNs ? ns : 0;
    drive_.on_time(now_ns_, said_);
    require(said_.size() == 0, "a drive that nobody asks says nothing");
    check_motor();
  }

  void hear(const Frame& frame) {
    const std::uint32_t id = drive_.config().id(), prefix = drive_.config().prefix();
    drive_.on_frame(frame, now_ns_, said_);
    require(said_.size() <= 1, "one answer to one frame");
    if (const Frame* answer = said_.front()) {
      const std::uint32_t destination = frame.id & 0xff;
      require((frame.id & 0x8000) != 0 && (destination == id || destination == 0x7f) && frame.id >> 16 == prefix,
              "an answer is to whoever asked for one");
      check_answer(*answer, frame);
    }
    said_.clear();
    check_motor();
  }

  // A line for the console, in pieces that frames carry; then what it says.
  void type(std::string_view words) {
    const std::uint32_t id = drive_.config().prefix() << 16 | 0x8000 | drive_.config().id();
    for (const std::string text = std::string(words) + "\n"; words.data() != nullptr; words = {}) {
      for (std::size_t at = 0; at < text.size(); at += 48) {
        const std::string_view piece = std::string_view(text).substr(at, 48);
        hear(frame_to(id, {reinterpret_cast<const std::uint8_t*>(piece.data()), piece.size()}));
      }
    }
    for (int i = 0; i < 4; ++i) hear(frame_to(id, {}));
  }

  void inject(std::uint8_t what) { drive_.inject(static_cast<InjectedFault>(what % 7), what / 7 % 2 != 0, now_ns_); }

 private:
  static sim::SimMoteusParams params() {
    sim::SimMoteusParams params;
    params.id = kId;
    params.plant.inertia_kg_m2 = 1e-3;
    params.plant.viscous_nm_s_rad = 1e-3;
    return params;
  }

  static Frame frame_to(std::uint32_t id, Bytes words) {
    Frame frame;
    frame.id = id;
    frame.extended = frame.fd = frame.brs = true;
    SubframeWriter writer(frame);
    words.empty() ? writer.poll(1, 48) : writer.client_data(1, words);
    writer.pad();
    return frame;
  }

  void check_answer(const Frame& answer, const Frame& question) {
    require(is_can(answer), "an answer is a frame that CAN has");
    const std::uint32_t ids = drive_.config().prefix() << 16 | drive_.config().id() << 8 | (question.id >> 8 & 0x7f);
    // A setting counts from the next frame on, or from this one: both are in the answer's favour.
    require((answer.id & 0x7f) == (ids & 0x7f), "an answer goes to the address that asked");
    SubframeReader reader(answer.payload());
    Subframe s;
    while (reader.next(s)) {
      const bool fits = s.kind == Kind::reply || s.kind == Kind::read_error || s.kind == Kind::write_error ||
                        s.kind == Kind::server_data;
      require(fits, "a drive answers, and does not ask");
    }
    require(reader.well_formed(), "an answer is well-formed");
  }

  void check_motor() {
    sim::Servo& servo = drive_.servo();
    const sim::Plant& plant = servo.plant();
    require(std::isfinite(plant.position_rad()) && std::isfinite(plant.velocity_rad_s()), "the joint is somewhere");
    require(std::abs(plant.torque_nm()) <= servo.params().motor_torque_max_nm * 1.0001, "no torque beyond the motor's");
    require(static_cast<unsigned>(servo.mode()) <= 15, "a mode is one of the protocol's");
  }

  sim::SimMoteus drive_;
  FrameQueue said_;
  std::int64_t now_ns_ = 1'000'000'000;
  std::int64_t spent_ns_ = 0;
};

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  Bench bench;
  for (int i = 0; i < kMostFrames && !input.empty(); ++i) {
    const std::uint8_t what = input.byte();
    switch (what % 8) {
      case 0:
        bench.pass(what / 8 * 1'000'000);
        break;
      case 1:
        bench.type(input.text(input.byte()));
        break;
      case 2:
        bench.inject(what / 8);
        break;
      default:
        bench.hear(input.frame(kLikely, what % 8 == 3));
    }
  }
}

namespace {

template <class Fill>
Frame frame_of(const Fill& fill) {
  Frame made;
  made.id = 0x8000 | kId;
  made.extended = made.fd = made.brs = true;
  SubframeWriter writer(made);
  fill(writer);
  writer.pad();
  return made;
}

void add_drives(std::vector<Seed>& all) {
  Script drives;
  for (const double mode : {10.0, 13.0, 9.0, 12.0, 15.0, 0.0, 11.0, 5.0, 99.0}) {
    drives.byte(4).frame(frame_of([&](SubframeWriter& writer) {
      writer.write(Format::int8, reg::kMode, std::array{mode});
      writer.write(Format::float32, reg::kCommandPosition, std::array{kSharp[4], 0.5, 0.1, 1.0, 1.0, 0.5});
      writer.read(Format::float32, reg::kMode, 4);
    }));
    drives.byte(0 + 8 * 12).byte(4).frame(frame_of([&](SubframeWriter& writer) {
      writer.read(Format::int16, reg::kTermP, 5);
      writer.read(Format::int32, reg::kUuid, 4);
    }));
    drives.byte(4).frame(frame_of([&](SubframeWriter& writer) { writer.read(Format::int8, reg::kEncoder, 8); }));
    drives.byte(2 + 8 * static_cast<unsigned>(mode)).byte(0 + 8 * 31);
    Script sharp;
    for (const double value : kSharp) {
      sharp.byte(4).frame(frame_of([&](SubframeWriter& writer) {
        writer.write(Format::int8, reg::kMode, std::array{mode});
        writer.write(Format::float32, reg::kCommandPosition, std::array{value, value, value});
        writer.write(Format::float32, reg::kWatchdog, std::array{value, value, value});
        writer.write(Format::float32, reg::kSetOutputExact, std::array{value});
      }));
      sharp.byte(0 + 8 * 10);
    }
    all.push_back(sharp);
  }
  // Mode 10 with gains and torque that are no numbers.
  Script nonsense;
  for (const double value : kSharp) {
    nonsense.byte(4).frame(frame_of([&](SubframeWriter& writer) {
      writer.write(Format::int8, reg::kMode, std::array{10.0});
      writer.write(Format::float32, reg::kCommandPosition,
                   std::array{0.0, 0.0, value, value, value, kSharp[4], kSharp[4]});
      writer.write(Format::int8, reg::kVelocityLimit, std::array{-1.0, -1.0});
    }));
    nonsense.byte(0 + 8 * 10);
  }
  all.insert(all.end(), {drives, nonsense});
}

}  // namespace

std::vector<Seed> seeds() {
  std::vector<Seed> all;
  add_drives(all);
  Script console;
  for (const std::string_view words : {"tel list",
                                       "tel get servo_stats",
                                       "tel schema servo_stats",
                                       "tel rate servo_stats 1",
                                       "tel fmt servo_stats 1",
                                       "tel text",
                                       "tel stop",
                                       "conf enumerate",
                                       "conf enumerate uuid",
                                       "conf get servo.pid_position.kp",
                                       "conf set servo.pid_position.kp 1e300",
                                       "conf set id.id 4",
                                       "conf write",
                                       "conf load",
                                       "conf default",
                                       "d pos nan 1 0.5 p1 d1 s3 f0.1 t1 v2 a3",
                                       "d within -1 1 0.2",
                                       "d dq 0 1",
                                       "d exact 1e9",
                                       "d nearest 3",
                                       "d cfg-set-output",
                                       "d tmt 0 0 1",
                                       "d zero 0 0 1",
                                       "d brake",
                                       "d stop",
                                       "d recapture",
                                       "hello"}) {
    console.byte(1).byte(static_cast<unsigned>(words.size())).text(words).byte(0 + 8 * 3);
    all.push_back(Script().byte(1).byte(static_cast<unsigned>(words.size())).text(words).byte(0 + 8 * 31));
  }
  all.push_back(console);
  return all;
}

}  // namespace lithe::fuzz
