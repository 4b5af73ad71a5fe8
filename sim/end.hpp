// SPDX-License-Identifier: Apache-2.0
// The outer end of a simulated bus: a pseudo terminal or a CAN interface.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "spine/core/result.hpp"
#include "spine/hal/bus/loop/sim_wire.hpp"
#include "spine/hal/bus/serial/sim_adapter.hpp"
#include "spine/hal/bus/socketcan/socketcan_bus.hpp"
#include "spine/hal/core/descriptor.hpp"

namespace lithe::simulator {

// Contract: not RT · one thread · times are CLOCK_MONOTONIC [ns] · nothing waits
class End : public Interface {
 public:
  virtual int poll_fd() const = 0;  // -1: no program is connected
  virtual bool wants_to_write() const { return false; }
  virtual void serve(std::int64_t now_ns) = 0;  // call when poll() reports input
  virtual void tick(std::int64_t now_ns) = 0;   // about once a millisecond
  virtual std::string place() const = 0;        // its path or interface; empty while it is unplugged
  // Unplugs until then. False: not possible for this kind.
  virtual bool unplug(std::int64_t /*until_ns*/) { return false; }
  // Puts an adapter's controller in bus-off, or ends the cause.
  virtual void set_bus_off(bool /*bad*/) {}
};

// An adapter at a pseudo terminal. Each program that opens it finds a freshly plugged-in adapter.
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
  void set_bus_off(bool bad) override { adapter_->set_bus_off(bad); }

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
  std::string out_;         // output not written yet
  bool half_told_ = false;  // its first line is partly written
};

// A CAN interface of the kernel. When it is down, it is tried again about once a second.
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
