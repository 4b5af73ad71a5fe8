// SPDX-License-Identifier: Apache-2.0
// Orders to simulated hardware: one JSON object per line.
#pragma once

#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"

namespace lithe::simulator {

//   {"fault": "drop", "bus": "can0", "share": 0.1}          also corrupt, duplicate, replay; share of frames, each way
//   {"fault": "delay", "bus": "can0", "ms": 5}              of frames from the devices
//   {"fault": "bus_off", "bus": "can0", "on": true}         no frame passes
//   {"fault": "unplug", "bus": "can0", "for_s": 1}          the adapter is unplugged, and plugged in again
//   {"fault": "reset", "device": "shoulder_drive"}          the device is switched off and on
//   {"fault": "watchdog", "device": "shoulder_drive"}       its watchdog expires
//   {"fault": "over_temperature", "device": "...", "on": true}     also encoder, device_fault, homing, register_map
//   {"fault": "twin", "device": "...", "on": true}          a second device with its id; wrong_id: it has another one
//   {"fault": "clear"}                                      all faults end
// Without "bus" or "device": all of them. "after_s": the fault begins later; "for_s": it ends by itself (not for reset,
// watchdog and clear).
struct FaultRequest {
  // `injected`: a fault of a device itself.
  enum class Kind { drop, corrupt, duplicate, replay, delay, bus_off, unplug, injected, twin, wrong_id, clear };
  Kind kind = Kind::clear;
  hal::InjectedFault injected{};  // which, with that kind
  std::string bus;
  std::string device;
  double amount = 0;  // share, or seconds of delay; 0 ends the fault
  bool on = true;
  double after_s = 0;
  double for_s = 0;  // 0: until ended by an order
};

// The error says what is wrong with the line, and what is expected.
// Contract: any bytes · never in the tick
Result<FaultRequest> parse_order(std::string_view line);

// True for orders about devices, false about buses.
bool is_of_device(FaultRequest::Kind kind);

// The order that ends this one.
FaultRequest undone(const FaultRequest& order);

}  // namespace lithe::simulator
