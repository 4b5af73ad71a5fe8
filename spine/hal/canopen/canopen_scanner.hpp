// SPDX-License-Identifier: Apache-2.0
// CANopen nodes for `lithe bus scan` and `lithe bus monitor`.
#pragma once

#include <memory>

#include "spine/hal/core/bus_tools.hpp"

namespace lithe::hal::canopen {

// Asks every id for object 1000h, then those that answered for their identity. Up to 4 s on a slow bus.
std::unique_ptr<Scanner> make_scanner();
// Any bytes are safe.
FrameText frame_text(const Frame& frame, const FrameContext& context);

}  // namespace lithe::hal::canopen
