// SPDX-License-Identifier: Apache-2.0
#include <span>

#include "sim/end.hpp"
#include "spine/hal/bus/socketcan/socketcan_codec.hpp"

namespace lithe::simulator {

Result<std::unique_ptr<CanEnd>> CanEnd::open(const hal::SocketCanParams& params, hal::sim::SimWire& wire) {
  Result<hal::Descriptor> socket = hal::open_can_socket(params);
  if (!socket) return socket.error();
  return std::unique_ptr<CanEnd>(new CanEnd(params, wire, std::move(*socket)));
}

void CanEnd::serve(std::int64_t now_ns) {
  constexpr int kMostReads = 64;  // then the other ends are served
  for (int i = 0; i < kMostReads; ++i) {
    canfd_frame raw{};
    const hal::Moved moved = socket_.read(std::as_writable_bytes(std::span(&raw, 1)));
    if (moved.error != 0) socket_.close();
    if (moved.bytes == 0) return;
    hal::Frame frame;
    hal::socketcan::ErrorCounts error_counts;
    const auto bytes = std::as_bytes(std::span(&raw, 1)).first(moved.bytes);
    if (hal::socketcan::decode(bytes, frame, error_counts) != hal::socketcan::Kind::frame) continue;
    wire_.on_frame(frame, now_ns, answers_);
    pass_on();
  }
}

void CanEnd::tick(std::int64_t now_ns) {
  constexpr std::int64_t kLookEveryNs = 1'000'000'000;
  if (!socket_.is_open() && now_ns >= look_at_ns_) {
    look_at_ns_ = now_ns + kLookEveryNs;
    if (Result<hal::Descriptor> found = hal::open_can_socket(params_); found) socket_ = std::move(*found);
  }
  wire_.on_time(now_ns, answers_);
  pass_on();
}

void CanEnd::pass_on() {
  for (; answers_.front() != nullptr; answers_.pop()) {
    canfd_frame raw{};
    const std::size_t size = hal::socketcan::encode(*answers_.front(), raw);
    // A frame without room in the interface is lost, as with a controller whose queue is full.
    if (size > 0 && socket_.is_open()) socket_.write(std::as_bytes(std::span(&raw, 1)).first(size));
  }
}

}  // namespace lithe::simulator
