// SPDX-License-Identifier: Apache-2.0
// The guard in the mode recover.
#include <algorithm>
#include <cmath>

#include "spine/guard/guard.hpp"

namespace lithe::guard {

void Guard::start_recovery() LITHE_RT { recovery_.restart(); }

// Slew-bounded from what each joint feels now, as every other output is, and bounded as every other by what still stops
// before a limit: both, or of a joint that comes from beyond one of them, the other. So a load above the torque of the
// recovery does not carry it through its range.
void Guard::recover(const Input& in, Output& out, Verdict& verdict) LITHE_RT {
  verdict.recovered = true;
  for (std::size_t j = 0; j < joints_; ++j) {
    const Limits& limit = limits_[j];
    const Seen now = seen(j, in);
    const double now_nm = std::clamp(sent_[j].felt_nm(ahead(now)), -limit.torque_max_nm, limit.torque_max_nm);
    const double wanted_nm = recovery_.torque_nm(j, now.position_rad, now.velocity_rad_s, now_nm);
    const double least_nm = std::max(now_nm - limit.slew_nm, -limit.torque_max_nm);
    const double most_nm = std::min(now_nm + limit.slew_nm, limit.torque_max_nm);
    const double slewed_nm = std::clamp(wanted_nm, least_nm, most_nm);
    const int from = recovery_.from(j);
    const double nm = from == 0 ? envelope_[j].bound(now, least_nm, slewed_nm, most_nm)
                                : envelope_[j].bound_one(now, least_nm, slewed_nm, most_nm, from < 0);
    if (slewed_nm != wanted_nm) verdict.flags |= wire::telemetry_flag::kSlewClamped;
    if (nm != slewed_nm) verdict.flags |= wire::telemetry_flag::kPositionClamped;
    safe_law_.rearm(j);
    Command command;
    command.torque_nm = nm;
    remember(j, now, command);
    at_envelope_[j] = false;
    out.rung[j] = Rung::law;
    out.torque_nm[j] = nm;
    out.position_rad[j] = kNoTarget;
    out.velocity_rad_s[j] = out.kp_nm_rad[j] = out.kd_nm_s_rad[j] = 0.0;
    out.max_torque_nm[j] = std::max(recovery_.torque_cap_nm(j), std::abs(nm));
    verdict.recovered = verdict.recovered && recovery_.recovered(j);
  }
  if (!verdict.recovered) verdict.flags |= wire::telemetry_flag::kRecovering;
  soft_start_ = recovery_.share();  // a law that follows has at least the torque that holds the joints now
}

}  // namespace lithe::guard
