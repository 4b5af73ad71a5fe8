// SPDX-License-Identifier: Apache-2.0
// Sensor gateways for `lithe bus scan` and `lithe bus monitor`. They are never asked.
#pragma once

#include <memory>

#include "spine/hal/core/bus_tools.hpp"

namespace lithe::hal::gateway {

std::unique_ptr<Scanner> make_scanner();
// Of a frame of a gateway.
FrameText frame_text(const Frame& frame, const FrameContext& context);

}  // namespace lithe::hal::gateway
