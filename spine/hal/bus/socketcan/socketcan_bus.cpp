// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/socketcan/socketcan_bus.hpp"

#include <array>
#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

namespace lithe::hal {
namespace {

// Limit of foreign frames that one receive() reads: a bus full of error frames must not block the exchange. It equals
// the socket's queue: these frames are before the answers, which are useless one exchange later.
constexpr int kMostPassedOver = 512;

// The interface works, but refuses this frame: its queue is full, or the frame is too long.
bool concerns_the_frame(int error) LITHE_RT { return error == ENOBUFS || error == EINVAL || error == EMSGSIZE; }

}  // namespace

SocketCanBus::SocketCanBus(const SocketCanParams& params, Opener opener, Look look, Descriptor socket)
    : interface_(params.interface),
      opener_(std::move(opener)),
      look_(std::move(look)),
      socket_(std::move(socket)),
      reply_wait_ns_(params.reply_wait_ns),
      fd_(params.data_bitrate > 0) {}

Result<std::unique_ptr<SocketCanBus>> SocketCanBus::open(const SocketCanParams& params) {
  return open(
      params, [params] { return open_can_socket(params); },
      [name = params.interface] { return look_at_carrier(name); });
}

Result<std::unique_ptr<SocketCanBus>> SocketCanBus::open(const SocketCanParams& params, Opener opener, Look look) {
  Result<Descriptor> socket = opener();
  if (!socket) return socket.error();
  return std::unique_ptr<SocketCanBus>(
      new SocketCanBus(params, std::move(opener), std::move(look), std::move(*socket)));
}

void SocketCanBus::begin(std::int64_t /*now_ns*/) LITHE_RT {
  if (link_.regained()) {
    ++statistics_.reopened;
    bus_off_.store(false, std::memory_order_relaxed);
  }
  if (!link_.up()) return;
  const Carrier seen = seen_.exchange(Carrier::unknown, std::memory_order_relaxed);
  if (seen != Carrier::unknown) bus_off_.store(seen == Carrier::off, std::memory_order_relaxed);
  stuck_.store(socket_.unsent_bytes() > 0, std::memory_order_relaxed);
}

bool SocketCanBus::refuse() LITHE_RT {
  ++statistics_.refused;
  return false;
}

bool SocketCanBus::send(const Frame& frame) LITHE_RT {
  if (!works() || (frame.fd && !fd_)) return refuse();
  canfd_frame raw;
  const std::size_t size = socketcan::encode(frame, raw);
  if (size == 0) return refuse();
  const Moved moved = socket_.write(std::as_bytes(std::span(&raw, 1)).first(size));
  if (moved.error != 0 && !concerns_the_frame(moved.error)) link_.lose(moved.error);
  if (moved.bytes == 0) return refuse();
  ++statistics_.sent;
  return true;
}

bool SocketCanBus::receive(Frame& frame) LITHE_RT {
  for (int i = 0; i < kMostPassedOver && link_.up(); ++i) {
    std::array<std::byte, sizeof(canfd_frame) + 1> bytes;  // one byte more, to detect longer packets
    const Moved moved = socket_.read(bytes);
    if (moved.error != 0) link_.lose(moved.error);
    if (moved.bytes == 0) return false;
    const socketcan::Kind kind = socketcan::decode(std::span(bytes).first(moved.bytes), frame);
    note(kind);
    if (kind == socketcan::Kind::frame) return true;
  }
  return false;
}

void SocketCanBus::note(socketcan::Kind kind) LITHE_RT {
  using enum socketcan::Kind;
  if (kind == frame) ++statistics_.received;
  if (kind == malformed) ++statistics_.malformed;
  if (kind == remote) ++statistics_.ignored;
  if (kind == error || kind == bus_off || kind == restarted) ++statistics_.errors;
  if (kind == bus_off || kind == restarted) bus_off_.store(kind == bus_off, std::memory_order_relaxed);
}

void SocketCanBus::service() {
  if (link_.lost() == 0) {
    seen_.store(look_(), std::memory_order_relaxed);
    return;
  }
  overrun_before_ += socket_.dropped();
  socket_.close();
  Result<Descriptor> socket = opener_();
  not_reopened_ = socket ? "" : socket.message();
  if (!socket) return;
  socket_ = std::move(*socket);
  link_.give_back();
}

std::string SocketCanBus::why_down() const {
  const int error = link_.lost();
  if (error == 0 && bus_off_.load(std::memory_order_relaxed)) return interface_ + ": " + advice_for_bus_off(interface_);
  if (error == 0 && stuck_.load(std::memory_order_relaxed)) {
    return interface_ +
           ": commands are not sent: they are not acknowledged, or the bus is too busy; check the drives' " +
           "power, wires, termination and bit rates";
  }
  if (error == 0) return "";
  if (!not_reopened_.empty()) return not_reopened_;
  return interface_ + ": the interface went away (" + std::strerror(error) +
         "); it is opened again as soon as it is back";
}

}  // namespace lithe::hal
