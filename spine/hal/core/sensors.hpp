// SPDX-License-Identifier: Apache-2.0
// Interface of a device that only measures.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal {

// The channels of such a device, in blocks. imu: 0 to 3 the attitude as a quaternion w x y z, 4 to 6 angular rate, 7 to
// 9 acceleration, x y z.
enum class Block : std::uint8_t { analog, digital, imu };
inline constexpr std::size_t kBlocks = 3;

// Driver: frames in, channels out.
// Contract: RT but for why_not_ready() · I/O only through the bus argument · one thread
class SensorDevice : public Interface {
 public:
  // True for a frame that this device sent.
  virtual bool sent(const Frame& frame) const LITHE_RT = 0;
  // Handles such a frame.
  virtual void on_frame(const Frame& frame, std::int64_t now_ns) LITHE_RT = 0;
  // Sends what the device needs, at most one frame: once per exchange, before the commands of drives.
  virtual void step(const Exchange& /*exchange*/, Bus& /*bus*/) LITHE_RT {}

  // False: never seen, not valid, or too old; `raw` is unchanged.
  virtual bool read(Block block, std::size_t channel, std::int64_t now_ns, double& raw) const LITHE_RT = 0;

  virtual std::uint64_t repeated() const LITHE_RT { return 0; }   // frames that came a second time: not used
  virtual std::uint64_t malformed() const LITHE_RT { return 0; }  // not used, either

  // Why it measures nothing, and the next step; empty = it works.
  // Contract: any thread but an exchange's
  virtual std::string why_not_ready() const { return ""; }
};

}  // namespace lithe::hal
