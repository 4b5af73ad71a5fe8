// SPDX-License-Identifier: Apache-2.0
// Actuators over any buses: one exchange per tick with all of them, answers matched to joints by address.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "spine/core/rt.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/bus/pi3hat/imu.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/gateway/gateway.hpp"

namespace lithe::hal {

// Where a frame carries the address of the device that sent it.
enum class Addressing : std::uint8_t {
  moteus,   // bits 8 to 14 of its id
  canopen,  // bits 0 to 6
};

// Contract: cycle() RT, bounded, one thread · add_bus, add_joint before the first cycle, never in the tick
class BusActuators final : public Actuators {
 public:
  // `clock` bounds the wait for answers of buses that need one (Bus::reply_wait_ns). A joint is lost after so many
  // exchanges in a row in which it was asked and did not answer. Two answers to one command that are not the same make
  // both worthless; after as many exchanges in a row of that, two devices answer for the joint.
  explicit BusActuators(const RawClock& clock = {}, std::uint32_t misses_to_lost = 3)
      : clock_(clock), misses_to_lost_(misses_to_lost) {}

  std::size_t add_bus(std::unique_ptr<Bus> bus, Addressing addressing, std::unique_ptr<BusMaster> master = nullptr);
  // Joints in the order of the robot's joints, at most kMaxJoints; addresses (1 to 126) differ on each bus. Asked in
  // one of `divider` exchanges, those of a bus in turn, or together where the bus has a master.
  void add_joint(std::size_t bus, std::uint32_t address, std::unique_ptr<Drive> drive, std::uint32_t divider = 1);

  // A gateway (1 to 126) beside whatever else is on the bus; its channels are not valid when older than `stale_ns`.
  std::size_t add_gateway(std::size_t bus, std::uint32_t node, std::int64_t stale_ns);
  // Sensors in the order of the robot's sensors: scale * raw + offset.
  void add_sensor(std::size_t gateway, gateway::Block block, std::size_t channel, double scale, double offset);
  // The IMU of a board, which outlives us; older readings than `stale_ns` are not valid. Its sensors as those above.
  std::size_t add_imu(ImuSource& source, std::int64_t stale_ns);
  void add_imu_sensor(std::size_t imu, std::size_t channel, double scale, double offset);

  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override;

  const ReplyCounters& counters() const LITHE_RT override { return counters_; }
  void share_core() override { shares_core_ = true; }

 private:
  static constexpr std::uint8_t kNobody = 0xff;
  static_assert(kMaxJoints < kNobody);

  struct Line {
    std::unique_ptr<Bus> bus;
    std::unique_ptr<BusMaster> master;
    Addressing addressing;
    std::uint32_t joints = 0;
    std::uint32_t gateways = 0;
    std::uint32_t unanswered = 0;            // of those asked in this exchange
    std::uint32_t patience = 0;              // frames that it may still bring, before the commands or after them
    std::array<std::uint8_t, 128> joint_at;  // by device address
  };
  struct Joint {
    std::size_t line;
    std::unique_ptr<Drive> drive;
    std::uint32_t divider;
    std::uint32_t turn;  // it is asked when the exchange's number leaves this remainder
    std::uint32_t misses_in_a_row = 0;
    std::uint32_t conflicts_in_a_row = 0;
    std::uint32_t sound_in_a_row = 0;  // since a conflict was told
    bool garbled = false;              // what came since its last answer made no sense
    bool contradicted = false;         // two answers to one command, and not the same
    std::uint32_t said_id = 0;         // of the answer: its frame, and what was in it
    std::uint64_t said = 0;
    JointSample sample{};  // counts when the exchange is over
    bool asked = false;
    bool awaited = false;
    bool heard = false;     // something whole came from it
    bool answered = false;  // with a measurement
  };

  struct GatewayPlace {
    std::size_t line;
    gateway::Gateway gateway;
  };
  struct Imu {
    ImuSource* source;
    std::int64_t stale_ns;
  };
  struct Sensor {
    bool of_imu;
    std::size_t source;  // of gateways_ or imus_
    gateway::Block block;
    std::size_t channel;
    double scale, offset;
  };

  // Our address changes with every exchange, and moteus drives answer to it: so a late answer is known as such.
  // As many as there are, without the broadcast's: one that is stuck somewhere for long is still known.
  static constexpr std::uint32_t kSources = 126;
  // A node that babbles must not keep the tick, so what a bus may bring is bounded. What waits from before the commands
  // never costs them their answers: a stall of the machine, or a gateway at a low rate, may leave that much.
  static constexpr std::uint32_t kMostWaiting = 256;
  // A lost drive is waited for in one of so many of its exchanges, so that it can be found again.
  static constexpr std::uint64_t kLookForLost = 32;
  // Two devices with one id are told until so many answers in a row had no second one.
  static constexpr std::uint32_t kSoundAgain = 32;

  void send_all(const ActuatorCommand& command) LITHE_RT;
  void collect() LITHE_RT;
  void drain(Line& line) LITHE_RT;
  void accept(Line& line, const Frame& frame) LITHE_RT;
  void answer(Line& line, Joint& joint, std::size_t index, const Frame& frame, const JointSample& sample) LITHE_RT;
  static void compare(Joint& joint, const Frame& frame) LITHE_RT;
  void accept_sensors(const Line& line, const Frame& frame) LITHE_RT;
  void read_sensors(ActuatorState& state) const LITHE_RT;
  bool read(const Sensor& sensor, double& raw) const LITHE_RT;
  void settle() LITHE_RT;
  void settle(Joint& joint, std::size_t index) LITHE_RT;
  void settle_answer(Joint& joint, std::size_t index) LITHE_RT;
  void settle_miss(Joint& joint, std::size_t index) LITHE_RT;

  RawClock clock_;
  std::uint32_t misses_to_lost_;
  bool shares_core_ = false;
  std::vector<Line> lines_;
  std::vector<Joint> joints_;
  std::vector<GatewayPlace> gateways_;
  std::vector<Imu> imus_;
  std::vector<Sensor> sensors_;
  ActuatorState last_;
  Exchange exchange_;
  std::uint64_t late_answers_ = 0;
  std::uint64_t repeated_answers_ = 0;
  std::uint64_t spoilt_answers_ = 0;
  ReplyCounters counters_;
};

}  // namespace lithe::hal
