// SPDX-License-Identifier: Apache-2.0
// The terms of a swap: from the robot file, changed by the request.
#pragma once

#include <cstdint>
#include <variant>

#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::swap {

struct Terms {
  double blend_s = 0.0;              // from the old law's torque to the new one's; 0 = the slew bound alone
  double probation_s = 0.0;          // automatic rollback for so long; 0 = none
  double error_ratio = 0.0;          // of the tracking error to the largest before; 0 = tracking is not judged
  double shadow_s = 0.0;             // runs in the shadow of the active law first; 0 = no shadow
  double shadow_tolerance_nm = 0.0;  // largest accepted difference of a torque
  double budget_us = 0.0;            // of one step
  double box_ms = 150.0;             // processor time of the trial

  std::uint32_t budget_ns() const { return static_cast<std::uint32_t>(budget_us * 1e3); }
  Json to_json() const;
};

// The robot file's terms. The default shadow tolerance is a tenth of the smallest torque limit.
Terms terms_of(const robot::RobotConfig& robot, double rate_hz);

// The arguments of a request that are terms: blend_s probation_s error_ratio shadow_s shadow_tolerance_nm budget_us
// box_ms. Others are ignored. A Refusal names the argument, its range and what it is for.
std::variant<Terms, Refusal> read_terms(const Json& args, const Terms& robot, double rate_hz);
bool is_term(const std::string& argument);

// The same in the Spine's units (ticks).
void put_terms(const Terms& terms, double rate_hz, wire::StageRequest& request);

}  // namespace lithe::swap
