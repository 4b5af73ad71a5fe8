// SPDX-License-Identifier: Apache-2.0
// The whole exchange, BusActuators::cycle, with five drives and a gateway on two buses whose far ends cannot be trusted
// (peer.hpp). Nothing reaches the map that no motor does; every frame is used or counted; an answer that is known to be
// old is not used; and when the tricks end, the drives are heard again.
#include <cmath>

#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/canopen/canopen_master.hpp"
#include "spine/hal/cia402/cia402_drive.hpp"
#include "spine/hal/cia402/sim/sim_cia402.hpp"
#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"
#include "spine/wire/wire.hpp"
#include "tests/fuzz/hal_input.hpp"
#include "tests/fuzz/peer.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
namespace status = wire::joint_status;

constexpr std::size_t kMoteus = 3, kJoints = 5, kSensors = 3;
constexpr std::uint32_t kGateway = 20;
constexpr std::int64_t kPeriodNs = 100'000;
constexpr int kMostExchanges = 120;
constexpr std::array<std::uint32_t, 8> kOnFd{0x100,
                                             0x200,
                                             0x301,
                                             0x181,
                                             0x500,
                                             gateway::kIdBase | kGateway << 8,
                                             gateway::kIdBase | kGateway << 8 | 1,
                                             gateway::kIdBase | 21 << 8};
constexpr std::array<std::uint32_t, 8> kOnClassic{0x181, 0x281, 0x581, 0x701, 0x081, 0x282, 0x182, 0x183};
constexpr std::array<JointTransform, kJoints> kTransforms{
    {{1, 0, 1}, {-1, 0.5, 6}, {1, -3, 1e-3}, {-1, 0, 20}, {1, 0, 1}}};
constexpr double kRatedNm = 1.27, kCounts = 4096;
constexpr double kScale = 0.5, kOffset = 3;

class Robot {
 public:
  Robot() {
    auto fd = std::make_unique<WatchedBus>(peer_[0], ledger_[0], kGateway);
    auto classic = std::make_unique<WatchedBus>(peer_[1], ledger_[1], 0);
    buses_ = {fd.get(), classic.get()};
    actuators_.add_bus(std::move(fd), hal::moteus::device_of);
    actuators_.add_bus(std::move(classic), hal::canopen::sender_of,
                       std::make_unique<canopen::CanopenMaster>(canopen::MasterParams{.heartbeat_s = 0.02}));
    for (std::uint32_t i = 0; i < kMoteus; ++i) add_moteus(i);
    for (std::uint32_t i = kMoteus; i < kJoints; ++i) add_cia402(i);
    peer_[0].attach(gateway_);
    const std::size_t place = actuators_.add_sensors(0, std::make_unique<gateway::Gateway>(kGateway, 5'000'000));
    actuators_.add_sensor(place, gateway::Block::analog, 0, kScale, kOffset);
    actuators_.add_sensor(place, gateway::Block::digital, 15, kScale, kOffset);
    actuators_.add_sensor(place, gateway::Block::imu, 9, kScale, kOffset);
    command_.joints = kJoints;
    command_.position_rad.fill(std::nan(""));
    for (int i = 0; i < 90; ++i) honest_cycle();
  }

  void cycle(Input& input) {
    command_.action[input.byte() % kJoints] = static_cast<DriveAction>(input.byte() % 4);
    command_.torque_nm[input.byte() % kJoints] = input.real();
    peer_[0].plan(input, kOnFd, ++number_);
    peer_[1].plan(input, kOnClassic, number_);
    exchange();
  }
  void honest_cycle() {
    command_.action.fill(DriveAction::off);
    for (Peer& peer : peer_) peer.behave(number_ + 1);
    ++number_;
    exchange();
  }

  // The tricks are over.
  void recovers() {
    for (int i = 0; i < 4; ++i) honest_cycle();
    for (std::size_t i = 0; i < kMoteus; ++i)
      require((state_.status[i] & status::kFresh) != 0, "a drive is heard again when the bus is good again");
    for (std::size_t bus = 0; bus < buses_.size(); ++bus) {
      const BusStatistics& count = buses_[bus]->statistics();
      require(count.received + count.late == peer_[bus].pushed(), "every frame on the bus is received or late");
    }
  }

 private:
  void add_moteus(std::uint32_t i) {
    sim::SimMoteusParams device;
    device.id = i + 1;
    device.serial = i + 1;
    device.joint = kTransforms[i];
    device.plant.inertia_kg_m2 = 1e-2;
    moteus_.push_back(std::make_unique<sim::SimMoteus>(device));
    peer_[0].attach(*moteus_.back());
    moteus::DriverParams driver;
    driver.id = i + 1;
    driver.joint = kTransforms[i];
    // The last one is asked in every second exchange only.
    actuators_.add_joint(0, i + 1, watched(std::make_unique<moteus::MoteusDrive>(driver), 0), i + 1 == kMoteus ? 2 : 1);
  }
  void add_cia402(std::uint32_t i) {
    const auto id = static_cast<std::uint32_t>(i + 1 - kMoteus);
    sim::SimCia402Params device;
    device.id = id;
    device.boot_ns = 0;
    device.joint = kTransforms[i];
    device.servo.counts_per_rev = kCounts;
    device.servo.rated_torque_nm = kRatedNm;
    device.plant.inertia_kg_m2 = 1e-2;
    cia402_.push_back(std::make_unique<sim::SimCia402>(device));
    peer_[1].attach(*cia402_.back());
    cia402::DriverParams driver;
    driver.id = id;
    driver.joint = kTransforms[i];
    driver.rated_torque_nm = kRatedNm;
    driver.counts_per_rev = kCounts;
    actuators_.add_joint(1, id, watched(std::make_unique<cia402::Cia402Drive>(driver), 1));
  }
  std::unique_ptr<Drive> watched(std::unique_ptr<Drive> drive, std::size_t bus) {
    return std::make_unique<WatchedDrive>(std::move(drive), ledger_[bus], bus == 0);
  }

  void exchange() {
    command_.tick = number_;
    const ActuatorState before = state_;
    actuators_.cycle(command_, state_, now_ns_ += kPeriodNs);
    check_map(before);
    check_counters();
  }

  void check_map(const ActuatorState& before) const {
    require(state_.tick == number_ && state_.sample_ns == now_ns_ && state_.joints == kJoints,
            "the map is of this exchange");
    for (std::size_t i = 0; i < kJoints; ++i) {
      const bool is_moteus = i < kMoteus;
      const JointSample sample{state_.position_rad[i], state_.velocity_rad_s[i], state_.torque_nm[i], 0, true};
      check_measured(sample, kTransforms[i], is_moteus ? kMotorRev : 2147483648.0 / kCounts,
                     is_moteus ? 1000 : 10 * kRatedNm);
      if ((state_.status[i] & status::kFresh) != 0) {
        require((state_.status[i] & status::kLost) == 0, "what is fresh is not lost");
        continue;
      }
      require(state_.position_rad[i] == before.position_rad[i] &&
                  state_.velocity_rad_s[i] == before.velocity_rad_s[i] && state_.torque_nm[i] == before.torque_nm[i],
              "what is not fresh stays as it was");
    }
    for (std::size_t i = 0; i < kSensors; ++i) {
      const double value = state_.sensor[i];
      require(std::isnan(value) || std::abs(value - kOffset) <= kScale * 32767,
              "a sensor is not valid, or in its range");
    }
    for (std::size_t i = kSensors; i < state_.sensor.size(); ++i)
      require(std::isnan(state_.sensor[i]), "no such sensor");
  }

  // What the product counts, against what passed by.
  void check_counters() const {
    const ReplyCounters& count = actuators_.counters();
    std::uint64_t received = 0, late = 0, malformed = 0, gateway = 0, taken = 0, repeated = 0, used = 0;
    for (std::size_t bus = 0; bus < buses_.size(); ++bus) {
      const Ledger& ledger = ledger_[bus];
      received += buses_[bus]->statistics().received;
      late += buses_[bus]->statistics().late + ledger.late;
      malformed += ledger.malformed + ledger.unmeasured + buses_[bus]->gateway().malformed;
      repeated += ledger.repeated + buses_[bus]->gateway().repeated;
      used += ledger.used;
      gateway += ledger.gateway;
      taken += ledger.taken();
      require(!ledger.old_was_used, "an answer that is known to be old is not used");
    }
    require(received == taken + gateway + count.stray, "every frame is a driver's, the gateway's or a stray");
    require(count.late == late, "every late frame is counted");
    require(count.malformed == malformed, "every spoilt frame is counted");
    require(count.duplicate == repeated, "every repeated frame is counted");
    require(count.missed + used <= number_ * kJoints, "a joint answers, or is missed, once an exchange");
  }

  std::array<Peer, 2> peer_;
  std::array<Ledger, 2> ledger_;
  std::vector<std::unique_ptr<sim::SimMoteus>> moteus_;
  std::vector<std::unique_ptr<sim::SimCia402>> cia402_;
  sim::SimGateway gateway_{kGateway, 500'000, true};
  BusActuators actuators_;
  std::array<const WatchedBus*, 2> buses_{};
  ActuatorCommand command_;
  ActuatorState state_;
  std::uint64_t number_ = 0;
  std::int64_t now_ns_ = 1'000'000'000;
};

}  // namespace

void run(Bytes bytes) {
  const auto robot = std::make_unique<Robot>();
  Input input(bytes);
  for (int i = 0; i < kMostExchanges && !input.empty(); ++i) robot->cycle(input);
  robot->recovers();
}

std::vector<Seed> seeds() {
  std::vector<Seed> all;
  Frame fd;
  fd.id = 0x100;
  fd.fd = fd.brs = true;
  fd.size = 64;
  fd.data.fill(0x24);
  for (unsigned trick = 0; trick < kTricks; ++trick) {
    for (const unsigned number : {0U, 3U, 40U, 65U, 130U, 250U}) {
      Script script;
      for (int exchange = 0; exchange < 24; ++exchange) {
        script.byte(exchange % 4).byte(0).real(0.1);
        for (const bool classic : {false, true}) {
          script.byte(3);
          for (int i = 0; i < 3; ++i) {
            const bool other = i == exchange % 3;
            script.byte(other ? trick : 0).byte(number);
            if (!other || trick < static_cast<unsigned>(Trick::invent)) continue;
            Frame frame = classic ? Frame{} : fd;
            if (classic) frame.id = kOnClassic[number % 8], frame.size = 8;
            script.frame(frame);
          }
        }
      }
      all.push_back(script);
    }
  }
  return all;
}

}  // namespace lithe::fuzz
