// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/socketcan_bus.hpp"

#include <array>
#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

namespace lithe::hal {
namespace {

// One receive() looks at so many frames that are none of ours: a bus full of errors must not keep the exchange.
constexpr int kMostPassedOver = 32;

// The interface works, and this frame is the trouble: no room in its queue, or longer than it carries.
bool concerns_the_frame(int error) LITHE_RT { return error == ENOBUFS || error == EINVAL || error == EMSGSIZE; }

}  // namespace

SocketCanBus::SocketCanBus(const SocketCanParams& params, Opener opener, Descriptor socket)
    : interface_(params.interface),
      opener_(std::move(opener)),
      socket_(std::move(socket)),
      reply_wait_ns_(params.reply_wait_ns),
      fd_(params.data_bitrate > 0) {}

Result<std::unique_ptr<SocketCanBus>> SocketCanBus::open(const SocketCanParams& params) {
  return open(params, [params] { return open_can_socket(params); });
}

Result<std::unique_ptr<SocketCanBus>> SocketCanBus::open(const SocketCanParams& params, Opener opener) {
  Result<Descriptor> socket = opener();
  if (!socket) return socket.error();
  return std::unique_ptr<SocketCanBus>(new SocketCanBus(params, std::move(opener), std::move(*socket)));
}

void SocketCanBus::begin(std::int64_t /*now_ns*/) LITHE_RT {
  if (!link_.regained()) return;
  ++statistics_.reopened;
  bus_off_.store(false, std::memory_order_relaxed);
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
    std::array<std::byte, sizeof(canfd_frame) + 1> bytes;  // one more: too long is seen as such
    const Moved moved = socket_.read(bytes);
    if (moved.error != 0) link_.lose(moved.error);
    if (moved.bytes == 0) return false;
    const socketcan::Troubles before = troubles_;
    switch (socketcan::decode(std::span(bytes).first(moved.bytes), frame, troubles_)) {
      case socketcan::Kind::frame:
        ++statistics_.received;
        return true;
      case socketcan::Kind::error:
        ++statistics_.errors;
        note_state(before);
        break;
      case socketcan::Kind::malformed:
        ++statistics_.malformed;
        break;
      case socketcan::Kind::remote:
        ++statistics_.ignored;
        break;
    }
  }
  return false;
}

void SocketCanBus::note_state(const socketcan::Troubles& before) LITHE_RT {
  if (troubles_.bus_off != before.bus_off) bus_off_.store(true, std::memory_order_relaxed);
  if (troubles_.restarted != before.restarted) bus_off_.store(false, std::memory_order_relaxed);
}

void SocketCanBus::service() {
  if (link_.lost() == 0) return;
  socket_.close();
  Result<Descriptor> socket = opener_();
  if (!socket) {
    not_reopened_ = socket.message();
    return;
  }
  socket_ = std::move(*socket);
  not_reopened_.clear();
  link_.give_back();
}

std::string SocketCanBus::why_down() const {
  const int error = link_.lost();
  if (error == 0 && bus_off_.load(std::memory_order_relaxed)) {
    return interface_ +
           ": bus-off, the controller saw too many errors; check wires, termination and bit rates, then: " +
           "sudo ip link set " + interface_ + " type can restart";
  }
  if (error == 0) return "";
  if (!not_reopened_.empty()) return not_reopened_;
  return interface_ + ": the interface went away (" + std::strerror(error) +
         "); it is opened again as soon as it is back";
}

}  // namespace lithe::hal
