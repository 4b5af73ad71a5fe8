// SPDX-License-Identifier: Apache-2.0
// A CAN interface of Linux, classic or FD, through a raw socket.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/socketcan/socketcan_codec.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/descriptor.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/core/link.hpp"

namespace lithe::hal {

struct SocketCanParams {
  std::string interface;                   // as `ip link` names it
  std::uint32_t bitrate = 1'000'000;       // set with `ip link`; used here for advice only
  std::uint32_t data_bitrate = 5'000'000;  // 0 = classic CAN only
  std::int64_t reply_wait_ns = 2'000'000;
};

// Each frame leaves as soon as it is sent; one for which the interface has no room is refused. While frames of an
// earlier exchange still wait, those of this one are refused: a controller without acknowledgement repeats its frame
// for ever, and outdated commands behind it would be executed when the drives return. So at most one exchange waits,
// plus the frames in the controller itself. While the controller is bus-off commands are refused, and none is sent
// after its restart, which the kernel does (`restart-ms`). An interface that goes down or away is opened again by
// service().
// Contract: as Bus · nothing is allocated between open() and the end, but in service() and why_down()
class SocketCanBus final : public Bus {
 public:
  using Opener = std::function<Result<Descriptor>()>;
  enum class Carrier : std::uint8_t { unknown, off, on };  // off: bus-off
  using Look = std::function<Carrier()>;

  // The error names the next step, if possible as a command to type.
  static Result<std::unique_ptr<SocketCanBus>> open(const SocketCanParams& params);
  // Over any non-blocking socket with one kernel frame per packet. `look`: reads the controller's state from the
  // kernel, because error frames may be lost and show only changes.
  static Result<std::unique_ptr<SocketCanBus>> open(const SocketCanParams& params, Opener opener, Look look);

  void begin(std::int64_t now_ns) LITHE_RT override;
  bool send(const Frame& frame) LITHE_RT override;
  bool receive(Frame& frame) LITHE_RT override;
  // 0 while it is down, bus-off or stuck: no answer can come.
  std::int64_t reply_wait_ns() const LITHE_RT override { return works() ? reply_wait_ns_ : 0; }
  void service() override;
  std::string why_down() const override;
  std::uint64_t overrun() const override { return overrun_before_ + socket_.dropped(); }

 private:
  SocketCanBus(const SocketCanParams& params, Opener opener, Look look, Descriptor socket);

  bool works() const LITHE_RT {
    return link_.up() && !bus_off_.load(std::memory_order_relaxed) && !stuck_.load(std::memory_order_relaxed);
  }
  bool refuse() LITHE_RT;
  void note(socketcan::Kind kind) LITHE_RT;

  std::string interface_;
  Opener opener_;
  Look look_;
  Descriptor socket_;
  Link link_;
  std::int64_t reply_wait_ns_;
  bool fd_;
  std::string not_reopened_;          // the reason; main thread only
  std::uint64_t overrun_before_ = 0;  // of closed sockets; main thread only
  // All relaxed: the first two are written by the exchange and only reported by why_down(); service() writes the third.
  std::atomic<bool> bus_off_{false};
  std::atomic<bool> stuck_{false};  // frames of an earlier exchange are not sent yet
  std::atomic<Carrier> seen_{Carrier::unknown};
};

// A raw socket on a CAN interface that is up, with all error frames and without our own frames.
// Contract: never in the tick
Result<Descriptor> open_can_socket(const SocketCanParams& params);

std::string advice_for_bus_off(const std::string& interface);

// The controller's state, from the kernel.
// Contract: never in the tick
SocketCanBus::Carrier look_at_carrier(const std::string& interface);

}  // namespace lithe::hal
