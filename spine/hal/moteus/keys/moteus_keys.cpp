// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/keys/moteus_keys.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>
#include <vector>

#include "spine/robot/read/reader.hpp"

namespace lithe::hal::moteus {

void read_keys(robot::Reader& in, Keys& keys) { in.boolean("may_hold_alone", keys.may_hold_alone); }

void read_frames(robot::Reader& in, FrameKeys& frames) {
  const std::vector<std::pair<std::string_view, Format>> formats{
      {"int8", Format::int8}, {"int16", Format::int16}, {"int32", Format::int32}, {"float", Format::float32}};
  std::vector<std::pair<std::string_view, std::optional<Format>>> or_none(formats.begin(), formats.end());
  or_none.emplace_back("none", std::nullopt);
  in.choice<Format>("command", frames.command, formats);
  in.choice<Format>("answer", frames.answer, formats);
  in.choice<std::optional<Format>>("current", frames.current, or_none);
  in.choice<std::optional<Format>>("power", frames.power, or_none);
  in.choice<bool>("settings", frames.settings_in_drive, {{"command", false}, {"drive", true}});
  in.finish();
}

void check_joint(robot::Reader& in, const Keys& keys, const robot::JointDemand& joint) {
  const Format narrower = std::min(keys.frames.command, keys.frames.answer);
  if (narrower > Format::int16) return;
  const auto check = [&](std::string_view key, double needed, Quantity quantity, std::string_view unit) {
    if (needed < largest(quantity, narrower)) return;
    in.complain(key, fmt::format("needs {:.3g} {} of the motor, and {} of \"{}\" ends at {:.4g}: say \"float\" in "
                                 "[device.frames]",
                                 needed, unit, narrower == Format::int8 ? "int8" : "int16", joint.device,
                                 largest(quantity, narrower)));
  };
  check("position_max_rad", joint.fault_rev, Quantity::position_rev, "turns");
  check("velocity_max_rad_s", joint.fault_rev_s, Quantity::velocity_rev_s, "turns/s");
  check("torque_max_nm", joint.torque_nm, Quantity::torque_nm, "Nm");
}

}  // namespace lithe::hal::moteus
