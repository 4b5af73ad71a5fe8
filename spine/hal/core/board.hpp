// SPDX-License-Identifier: Apache-2.0
// A board that several buses and an IMU are on, and the IMU: attitude, angular rate, acceleration.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "spine/core/rt.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/sensors.hpp"

namespace lithe::hal {

inline constexpr std::size_t kImuChannels = 10;

// Channels as those of a gateway's block of this name: 0 to 3 the attitude as a quaternion w x y z, 4 to 6 angular rate
// [rad/s], 7 to 9 acceleration [m/s^2], x y z of the board.
struct ImuReading {
  std::array<double, kImuChannels> value{};
  std::int64_t taken_ns = 0;  // CLOCK_MONOTONIC of the exchange that brought it
  bool valid = false;         // a reading exists and is plausible
};

// Contract: RT · one thread
class ImuSource : public Interface {
 public:
  // The newest reading; the caller checks its age.
  virtual const ImuReading& imu(std::int64_t now_ns) LITHE_RT = 0;
};

// What all buses of one board share.
// Contract: never in the tick · made as a shared pointer; its buses keep it alive
class BusBoard {
 public:
  BusBoard() = default;
  BusBoard(const BusBoard&) = delete;
  BusBoard& operator=(const BusBoard&) = delete;
  virtual ~BusBoard() = default;
  // The bus of this connector, from 1.
  virtual std::unique_ptr<Bus> open_bus(std::uint32_t connector) = 0;
  // The IMU, which every exchange reads from now on.
  // Contract: before the first exchange
  virtual ImuSource& want_imu() = 0;
};

// The IMU of a board as a device. It is on no bus.
// Contract: as SensorDevice · the source outlives it
class BoardImu final : public SensorDevice {
 public:
  // Readings older than `stale_ns` are not valid.
  BoardImu(ImuSource& source, std::int64_t stale_ns) : source_(source), stale_ns_(stale_ns) {}

  bool sent(const Frame& /*frame*/) const LITHE_RT override { return false; }
  void on_frame(const Frame& /*frame*/, std::int64_t /*now_ns*/) LITHE_RT override {}
  bool read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT override {
    const ImuReading& reading = source_.imu(now_ns);
    if (!reading.valid || block != Block::imu || channel >= kImuChannels || now_ns - reading.taken_ns > stale_ns_)
      return false;
    raw = reading.value[channel];
    return true;
  }

 private:
  ImuSource& source_;
  std::int64_t stale_ns_;
};

}  // namespace lithe::hal
