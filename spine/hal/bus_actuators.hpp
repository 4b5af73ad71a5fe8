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
#include "spine/hal/core/drive.hpp"
#include "spine/hal/core/sensors.hpp"

namespace lithe::hal {

// Address of the device that sent a frame, by the protocol of its bus; one that no device has: not a frame of a device.
using SenderOf = std::uint32_t (*)(const Frame& frame) LITHE_RT;

// Contract: cycle() RT, bounded, one thread · add_bus, add_joint before the first cycle, never in the tick
class BusActuators final : public Actuators {
 public:
  // `clock` bounds the wait for answers (Bus::reply_wait_ns). A joint is lost after this many exchanges in a row in
  // which it was asked and did not answer. Two different answers to one command are both dropped; after the same number
  // of such exchanges in a row the joint has a conflict (two devices with one id).
  explicit BusActuators(const RawClock& clock = {}, std::uint32_t misses_to_lost = 3)
      : clock_(clock), misses_to_lost_(misses_to_lost) {}

  std::size_t add_bus(std::unique_ptr<Bus> bus, SenderOf sender_of, std::unique_ptr<BusMaster> master = nullptr);
  // Joints in the order of the robot's joints, at most kMaxJoints; addresses (1 to 126) differ on each bus. Asked in
  // one of `divider` exchanges, those of a bus in turn, or together where the bus has a master.
  void add_joint(std::size_t bus, std::uint32_t address, std::unique_ptr<Drive> drive, std::uint32_t divider = 1);

  // A device that only measures, beside whatever else is on the bus.
  std::size_t add_sensors(std::size_t bus, std::unique_ptr<SensorDevice> device);
  // Sensors in the order of the robot's sensors: scale * raw + offset. `device` as add_sensors() returned it.
  void add_sensor(std::size_t device, Block block, std::size_t channel, double scale, double offset);

  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override;

  const ReplyCounters& counters() const LITHE_RT override { return counters_; }
  void share_core() override { shares_core_ = true; }

 private:
  static constexpr std::uint8_t kNoJoint = 0xff;
  static_assert(kMaxJoints < kNoJoint);

  struct Line {
    std::unique_ptr<Bus> bus;
    std::unique_ptr<BusMaster> master;
    SenderOf sender_of;  // null: no drives
    std::uint32_t joints = 0;
    std::uint32_t sensor_devices = 0;
    std::uint32_t unanswered = 0;            // number of asked joints without an answer
    std::uint32_t patience = 0;              // frames that may still be read, before or after the commands
    std::array<std::uint8_t, 128> joint_at;  // by device address
  };
  struct Joint {
    std::size_t line;
    std::unique_ptr<Drive> drive;
    std::uint32_t divider;
    std::uint32_t turn;  // asked when exchange number % divider is this
    std::uint32_t misses_in_a_row = 0;
    std::uint32_t conflicts_in_a_row = 0;
    std::uint32_t sound_in_a_row = 0;  // since the last conflict
    bool garbled = false;              // only invalid frames since its last answer
    bool contradicted = false;         // two different answers to one command
    std::uint32_t said_id = 0;         // id and hash of the answer's frame
    std::uint64_t said = 0;
    JointSample sample{};  // used after the exchange
    bool asked = false;
    bool awaited = false;
    bool heard = false;     // a complete frame came from it
    bool answered = false;  // with a measurement
  };

  struct SensorPlace {
    std::size_t line;
    std::unique_ptr<SensorDevice> device;
  };
  struct Sensor {
    std::size_t place;  // index into sensor_places_
    Block block;
    std::size_t channel;
    double scale, offset;
  };

  // Our source address changes with every exchange, and moteus drives answer to it, so a late answer is recognised. All
  // addresses except broadcast are used, so that even a very late answer is recognised.
  static constexpr std::uint32_t kSources = 126;
  // The number of frames read per exchange is bounded, so that a node that sends continuously cannot block the tick.
  // Frames from before the commands have their own bound, so that they never displace answers: after a stall of the
  // machine, or with a gateway at a low rate, many may be waiting.
  static constexpr std::uint32_t kMostWaiting = 256;
  // A lost drive is waited for in one of this many of its exchanges, so that it can be found again.
  static constexpr std::uint64_t kLookForLost = 32;
  // A conflict is reported until this many answers in a row came without a second one.
  static constexpr std::uint32_t kSoundAgain = 32;

  void send_all(const ActuatorCommand& command) LITHE_RT;
  void collect() LITHE_RT;
  void drain(Line& line) LITHE_RT;
  void accept(Line& line, const Frame& frame) LITHE_RT;
  void answer(Line& line, Joint& joint, std::size_t index, const Frame& frame, const JointSample& sample) LITHE_RT;
  static void compare(Joint& joint, const Frame& frame) LITHE_RT;
  bool accept_sensors(const Line& line, const Frame& frame) LITHE_RT;
  void read_sensors(ActuatorState& state) const LITHE_RT;
  void settle() LITHE_RT;
  void settle(Joint& joint, std::size_t index) LITHE_RT;
  void settle_answer(Joint& joint, std::size_t index) LITHE_RT;
  void settle_miss(Joint& joint, std::size_t index) LITHE_RT;

  RawClock clock_;
  std::uint32_t misses_to_lost_;
  bool shares_core_ = false;
  std::vector<Line> lines_;
  std::vector<Joint> joints_;
  std::vector<SensorPlace> sensor_places_;
  std::vector<Sensor> sensors_;
  ActuatorState last_;
  Exchange exchange_;
  std::uint64_t late_answers_ = 0;
  std::uint64_t repeated_answers_ = 0;
  std::uint64_t malformed_answers_ = 0;
  ReplyCounters counters_;
};

}  // namespace lithe::hal
