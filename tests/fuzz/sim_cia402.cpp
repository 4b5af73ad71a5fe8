// SPDX-License-Identifier: Apache-2.0
// A simulated CiA 402 drive and a simulated gateway behind a bad wire: any frames, any faults, any pauses.
#include "spine/hal/cia402/sim/sim_cia402.hpp"

#include <cmath>
#include <limits>

#include "spine/hal/bus/loop/sim_wire.hpp"
#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using namespace hal::canopen;
namespace object = cia402::object;

constexpr std::uint32_t kNode = 5;
constexpr std::uint32_t kGateway = 20;
constexpr std::array<std::uint32_t, 7> kLikely{0x000, 0x080, 0x605, 0x205, 0x305, 0x77f, 0x604};
constexpr int kMostFrames = 128;
constexpr std::int64_t kMostNs = 400'000'000;  // of simulated time in one input

class Bench {
 public:
  Bench() : drive_(params()), gateway_(kGateway, 1'000'000, true), wire_(7) {
    wire_.attach(drive_);
    wire_.attach(gateway_);
  }

  void pass(std::int64_t ns) {
    spent_ns_ += ns;
    now_ns_ += spent_ns_ < kMostNs ? ns : 0;
    wire_.on_time(now_ns_, said_);
    check();
  }
  void hear(const Frame& frame) {
    wire_.on_frame(frame, now_ns_, said_);
    check();
  }
  void inject(std::uint8_t what) { drive_.inject(static_cast<InjectedFault>(what % 7), what / 7 % 2 != 0, now_ns_); }
  void spoil(std::uint8_t what) {
    const auto share = [&](unsigned bit) { return (what >> bit & 1) != 0 ? 0.5 : 0.0; };
    wire_.set_faults({.drop = share(0),
                      .corrupt = share(1),
                      .duplicate = share(2),
                      .replay = share(4),
                      .delay_ns = (what & 8) != 0 ? 3'000'000 : 0,
                      .bus_off = what > 0xf0});
  }

 private:
  static sim::SimCia402Params params() {
    sim::SimCia402Params params;
    params.id = kNode;
    params.boot_ns = 0;
    params.plant.inertia_kg_m2 = 1e-3;
    params.plant.viscous_nm_s_rad = 1e-3;
    return params;
  }

  void check() {
    const bool spoilt = wire_.faults().corrupt > 0;
    for (; const Frame* each = said_.front(); said_.pop()) {
      require(is_can(*each), "what is said is a frame that CAN has");
      if (spoilt || gateway::is_gateway(*each)) continue;
      require(is_canopen(*each), "what a drive says is CANopen");
    }
    const sim::Plant& plant = drive_.servo().plant();
    require(std::isfinite(plant.position_rad()) && std::isfinite(plant.velocity_rad_s()), "the joint is somewhere");
    require(std::abs(plant.torque_nm()) <= kMostNm * 1.0001, "no torque beyond the motor's");
    cia402::State state{};
    require(cia402::decode_state(drive_.servo().statusword(), state), "its status word is that of a state");
  }

  static constexpr double kMostNm = sim::Cia402ServoParams{}.motor_torque_max_nm;
  sim::SimCia402 drive_;
  sim::SimGateway gateway_;
  sim::SimWire wire_;
  FrameQueue said_;
  std::int64_t now_ns_ = 1'000'000'000;
  std::int64_t spent_ns_ = 0;
};

}  // namespace

void run(Bytes bytes) {
  Input input(bytes);
  Bench bench;
  bench.pass(0);
  bench.pass(0);
  for (int i = 0; i < kMostFrames && !input.empty(); ++i) {
    const std::uint8_t what = input.byte();
    switch (what % 8) {
      case 0:
        bench.pass(what / 8 * 1'000'000);
        break;
      case 1:
        bench.inject(what / 8);
        break;
      case 2:
        bench.spoil(input.byte());
        break;
      default:
        bench.hear(input.frame(kLikely, what % 8 == 3));
    }
  }
}

std::vector<Seed> seeds() {
  std::vector<Seed> all;
  const auto write = [](Script& script, std::uint16_t index, std::uint8_t subindex, std::uint32_t value,
                        std::size_t bytes) {
    script.byte(4).frame(sdo_write_request(kNode, {index, subindex}, value, bytes));
  };
  for (const std::uint8_t mode : List<std::uint8_t>{8, 9, 10}) {
    for (const std::uint32_t target : {0U, 1000U, 0x7fffffffU, 0x80000000U}) {
      Script script;
      script.byte(4).frame(nmt_frame(NmtCommand::start, kNode));
      write(script, object::kMode, 0, mode, 1);
      write(script, 0x1016, 1, 127U << 16 | 20, 4);
      write(script, object::kTargetPosition, 0, target, 4);
      write(script, object::kTargetVelocity, 0, target, 4);
      write(script, object::kTargetTorque, 0, target & 0xffff, 2);
      write(script, object::kPositionOffset, 0, target, 4);
      write(script, object::kQuickStopDeceleration, 0, target, 4);
      write(script, 0x1017, 0, 5, 2);
      for (const std::uint32_t word : {0x06U, 0x07U, 0x0fU}) write(script, object::kControlword, 0, word, 2);
      script.byte(0 + 8 * 20).byte(4).frame(heartbeat_frame(127, NmtState::operational));
      script.byte(4).frame(sync_frame()).byte(0 + 8 * 30).byte(4).frame(sync_frame());
      write(script, object::kControlword, 0, 0x02, 2);
      script.byte(0 + 8 * 30).byte(1 + 8 * (3 + mode % 3)).byte(0 + 8 * 30);
      all.push_back(script);
    }
  }
  Script mapping, reads;
  for (const std::uint16_t number : List<std::uint16_t>{0, 1}) {
    for (const std::uint16_t base : List<std::uint16_t>{0x1400, 0x1800}) {
      const auto communication = static_cast<std::uint16_t>(base + number);
      const auto map = static_cast<std::uint16_t>(communication + 0x200);
      write(mapping, communication, 1, 0x80000000U | 0x205U, 4);
      write(mapping, map, 0, 0, 1);
      write(mapping, map, 1, 0x60400010, 4);
      write(mapping, map, 2, 0x607a0020, 4);
      write(mapping, map, 0, 2, 1);
      write(mapping, communication, 2, 255, 1);
      write(mapping, communication, 1, base == 0x1400 ? 0x205 : 0x185, 4);
    }
  }
  mapping.byte(4).frame(nmt_frame(NmtCommand::start, 0)).byte(4).frame(blank(0x205, 6)).byte(4).frame(blank(0x205, 3));
  for (const std::uint16_t index : List<std::uint16_t>{0x1000, 0x1008, 0x1018, 0x6041, 0x6064, 0x2000}) {
    reads.byte(4).frame(sdo_read_request(kNode, {index, 0}));
    for (const bool toggle : {false, true, false, false}) reads.byte(4).frame(sdo_segment_request(kNode, toggle));
  }
  reads.byte(2).byte(0x0f);
  for (unsigned i = 0; i < 20; ++i) reads.byte(4).frame(sdo_read_request(kNode, {0x6041, 0})).byte(0 + 8);
  for (const NmtCommand command : {NmtCommand::stop, NmtCommand::enter_pre_operational, NmtCommand::reset_node,
                                   NmtCommand::reset_communication, NmtCommand::start}) {
    reads.byte(4).frame(nmt_frame(command, kNode)).byte(0 + 8 * 4);
  }
  all.insert(all.end(), {mapping, reads});
  return all;
}

}  // namespace lithe::fuzz
