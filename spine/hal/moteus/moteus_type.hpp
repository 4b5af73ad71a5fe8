// SPDX-License-Identifier: Apache-2.0
// A moteus in a robot file: what the registry's row needs of it.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/core/planned_frame.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::moteus {

std::unique_ptr<Drive> make_drive(const robot::RobotConfig& robot, const robot::JointConfig& joint);
// The driver's own command, and the answer to it.
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);
std::unique_ptr<Scanner> make_scanner();
// Any bytes are safe.
FrameText frame_text(const Frame& frame, const FrameContext& context);
// For example "fault: over-temperature (38)".
std::string state_words(std::uint32_t mode, std::uint32_t code);

}  // namespace lithe::hal::moteus
