// SPDX-License-Identifier: Apache-2.0
// Where a simulated bus meets the rest of the world.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "spine/core/result.hpp"
#include "spine/hal/core/descriptor.hpp"
#include "spine/hal/bus/socketcan/socketcan_bus.hpp"
#include "spine/hal/bus/serial/sim_adapter.hpp"
#include "spine/hal/bus/loop/sim_wire.hpp"

namespace lithe::simulator {

// Contract: not RT · one thread · times are CLOCK_MONOTONIC [ns] · nothing waits
class End {
 public:
  End() = default;
  End(const End&) = delete;
  End& operator=(const End&) = delete;
  virtual ~End() = default;

  virtual int poll_fd() const = 0;  // -1: nobody is there to be heard
  virtual bool wants_to_write() const { return false; }
  virtual void serve(std::int64_t now_ns) = 0;  // after poll said so
  virtual void tick(std::int64_t now_ns) = 0;   // about once a millisecond
  virtual std::string place() const = 0;        // how others reach it; empty while it is unplugged
  // Goes away until then. False: this kind cannot.
  virtual bool unplug(std::int64_t /*until_ns*/) { return false; }
  // The wires behind an adapter drive its controller bus-off, or are good again.
  virtual void spoil_wires(bool /*bad*/) {}
};

// An adapter at a pseudo terminal. Who opens it meets an adapter that was just plugged in.
class PtyEnd final : public End {
 public:
  // `link`: path of a symbolic link to the terminal, there while the terminal can be opened; empty = none.
  static Result<std::unique_ptr<PtyEnd>> open(std::unique_ptr<hal::sim::SimAdapter> adapter, std::string link);
  ~PtyEnd() override;

  int poll_fd() const override { return somebody_ ? master_.get() : -1; }
  bool wants_to_write() const override { return somebody_ && !out_.empty(); }
  void serve(std::int64_t now_ns) override;
  void tick(std::int64_t now_ns) override;
  std::string place() const override { return slave_path_; }
  bool unplug(std::int64_t until_ns) override;
  void spoil_wires(bool bad) override { adapter_->spoil_wires(bad); }

 private:
  PtyEnd(std::unique_ptr<hal::sim::SimAdapter> adapter, std::string link)
      : adapter_(std::move(adapter)), link_(std::move(link)) {}

  Result<> plug();
  void look_for_somebody();
  void leave();
  void write_out();
  void remove_link();

  std::unique_ptr<hal::sim::SimAdapter> adapter_;
  std::string link_;
  hal::Descriptor master_;
  std::string slave_path_;
  bool somebody_ = false;
  std::int64_t plug_at_ns_ = 0;
  std::string out_;         // what the terminal had no room for yet
  bool half_told_ = false;  // its first line has partly left
};

// A CAN interface of the kernel. When it is down, it is looked for again about once a second.
class CanEnd final : public End {
 public:
  static Result<std::unique_ptr<CanEnd>> open(const hal::SocketCanParams& params, hal::sim::SimWire& wire);

  int poll_fd() const override { return socket_.get(); }
  void serve(std::int64_t now_ns) override;
  void tick(std::int64_t now_ns) override;
  std::string place() const override { return socket_.is_open() ? params_.interface : ""; }

 private:
  CanEnd(const hal::SocketCanParams& params, hal::sim::SimWire& wire, hal::Descriptor socket)
      : params_(params), wire_(wire), socket_(std::move(socket)) {}

  void pass_on();

  hal::SocketCanParams params_;
  hal::sim::SimWire& wire_;
  hal::Descriptor socket_;
  hal::FrameQueue answers_;
  std::int64_t look_at_ns_ = 0;
};

}  // namespace lithe::simulator
