// SPDX-License-Identifier: Apache-2.0
// What the tools for buses (plan, scan, monitor) need of a kind of device: the frames that it and the bus's master
// send, which devices are on a bus, and the text of a frame.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal {

// Frames of one kind, for planning a bus. Its identifier is id + i * id_step modulo id_wrap for the i-th of them: that
// of a moteus changes with every exchange.
struct PlannedFrame {
  const char* what;      // "command", "answer", "SYNC" ...
  std::size_t size = 0;  // bytes of data as on the wire
  std::uint32_t id = 0;
  bool fd = false;
  bool outbound = false;  // from the robot's computer to a device
  double per_tick = 0;    // frames, with the device's rate divider
  double per_s = 0;       // those that go by the clock instead
  bool unasked = false;   // sent by the device's own clock
  bool on_bus = true;     // false: on its board only
  std::uint32_t id_step = 0;
  std::uint32_t id_wrap = 1;

  constexpr std::uint32_t id_of(std::uint32_t number) const { return id + number * id_step % id_wrap; }
};

using PlannedFrames = std::vector<PlannedFrame>;

// The clock of a tool that waits for frames.
struct Time {
  std::function<std::int64_t()> now_ns;  // CLOCK_MONOTONIC
  std::function<void()> pause;           // waits briefly for frames
};

// One device that a scan has found.
struct FoundDevice {
  std::uint32_t id = 0;
  std::string what;                        // its own description, as text
  std::optional<std::uint32_t> profile{};  // of a CANopen device: the low half of object 1000h
  std::string twice{};                     // several devices have this id: what to do; empty = one has it
  std::string unfit{};                     // why LITHE cannot use it, and what to do; empty = it can
};

// A bus whose devices are asked.
struct AskedBus {
  Bus& bus;
  const Time& time;
  std::uint32_t bitrate = 1'000'000;
  std::function<void(const Frame&)> other;  // gets the frames that are no answers to us
};

// Finds the devices of one protocol or kind on a bus. It only reads; it changes no mode or state.
// Contract: not RT · one thread, which alone uses the bus · any frame is safe
class Scanner : public Interface {
 public:
  // Handles a frame that is no answer to us. Returns the evidence that another program commands the bus; empty = none.
  virtual std::string on_frame(const Frame& frame) = 0;
  // Asks which devices are there. Returns the bus error that kept some from being asked; empty = none.
  virtual std::string ask(const AskedBus& /*line*/) { return ""; }
  // In order of their ids. `asked`: all were asked, and the bus worked.
  virtual std::vector<FoundDevice> found(bool asked) const = 0;
};

// The text of one frame.
struct FrameText {
  bool outbound = false;  // towards a device, guessed from the content; used when the true direction is unknown
  std::optional<std::uint32_t> device;  // id of the sender or receiver; empty = broadcast, or unknown
  std::string text;                     // never empty, printable
};

// What the text of a CANopen frame needs of the kinds of devices and of the robot file.
struct FrameContext {
  std::function<std::string(const Frame&)> process_data;             // its values; empty = of no device of the file
  std::function<std::string_view(std::uint16_t index)> object_name;  // of a device profile; empty = unknown
};

// The bytes in hexadecimal; "no data" without any.
std::string bytes_text(const Frame& frame);

}  // namespace lithe::hal
