// SPDX-License-Identifier: Apache-2.0
// moteus drives for `lithe bus scan` and `lithe bus monitor`.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/moteus/moteus_terminal.hpp"

namespace lithe::hal::moteus {

// Text for one drive. Without an identity: `why_unknown`.
FoundDevice describe(const Found& found, const std::optional<Identity>& identity, const std::string& why_unknown = "");

std::unique_ptr<Scanner> make_scanner();
// Any bytes are safe.
FrameText frame_text(const Frame& frame, const FrameContext& context);

}  // namespace lithe::hal::moteus
