// SPDX-License-Identifier: Apache-2.0
// The answer of a command, and what became of joints that moved when the drives were switched off.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "supervisor/link/spine/commands.hpp"

namespace lithe::control {

using wire::CommandKind;

bool Commands::switches_off(CommandKind kind) { return kind == CommandKind::disarm || kind == CommandKind::reset; }

Json Commands::result_json(const Pending& done, const wire::Telemetry& now, std::int64_t now_ns) {
  Json result = {{"mode", std::string(to_string(static_cast<wire::Mode>(now.mode)))},
                 {"fault", std::string(to_string(static_cast<wire::Fault>(now.fault)))},
                 {"tick", now.tick}};
  if (!switches_off(static_cast<CommandKind>(done.command.kind))) return result;
  const auto [joint, rad_s] = done.moving;
  if (joint.empty())
    result["what"] = "no joint moved; the drives are off";
  else if (done.command.count != 0)
    result["what"] = fmt::format("off at once: joint {} moved at {:.2f} rad/s and was not braked", joint, rad_s);
  else
    result["what"] = fmt::format("braked joint {} from {:.2f} rad/s{}, {:.2f} s", joint, rad_s,
                                 result["mode"] == "disarmed" ? " to rest, then off" : "; then an e-stop",
                                 static_cast<double>(now_ns - done.sent_ns) * 1e-9);
  return result;
}

Commands::Moving Commands::moving() const {
  constexpr double kAtRestRadS = 0.05;  // as the guard's
  const wire::Telemetry now = spine_.now();
  const auto mode = static_cast<wire::Mode>(now.mode);
  Moving fastest{"", kAtRestRadS};
  if (mode == wire::Mode::disarmed || mode == wire::Mode::estop) return fastest;
  for (std::size_t j = 0; j < std::min<std::size_t>(now.joint_count, wire::kNj); ++j) {
    const double rad_s = std::abs(now.velocity_rad_s[j]);
    if (rad_s >= fastest.rad_s) fastest = {joint_name(spine_.info(), j), rad_s};
  }
  return fastest;
}

}  // namespace lithe::control
