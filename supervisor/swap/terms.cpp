// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/terms.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace lithe::swap {
namespace {

struct Argument {
  const char* name;
  double Terms::* field;
  double least, most;
  bool or_zero;  // 0 switches it off, whatever `least` says
  const char* what;
};

constexpr double kTickLimit = std::numeric_limits<double>::infinity();  // as long as one tick

constexpr Argument kArguments[] = {
    {"blend_s", &Terms::blend_s, 0.0, 5.0, true, "from the old law's torque to the new one's"},
    {"probation_s", &Terms::probation_s, 0.0, 60.0, true, "automatic rollback for so long, 0 = none"},
    {"error_ratio", &Terms::error_ratio, 1.0, 1e6, true, "roll back when tracking gets so many times worse, 0 = never"},
    {"shadow_s", &Terms::shadow_s, 0.0, 60.0, true, "beside the active law first, 0 = no shadow"},
    {"shadow_tolerance_nm", &Terms::shadow_tolerance_nm, 1e-9, 1e6, false, "largest difference that is agreement"},
    {"budget_us", &Terms::budget_us, 1.0, kTickLimit, false, "of one step"},
    {"box_ms", &Terms::box_ms, 20.0, 5000.0, false, "processor time of the trial"},
};

std::uint32_t ticks(double seconds, double rate_hz) {
  return seconds > 0 ? static_cast<std::uint32_t>(std::max(1.0, std::round(seconds * rate_hz))) : 0;
}

}  // namespace

Json Terms::to_json() const {
  Json out = Json::object();
  for (const Argument& each : kArguments) {
    out[each.name] = this->*each.field;
  }
  return out;
}

Terms terms_of(const robot::RobotConfig& robot, double rate_hz) {
  Terms terms;
  terms.blend_s = robot.swap.blend_s;
  terms.probation_s = robot.swap.probation_s;
  terms.error_ratio = robot.swap.probation_error_ratio;
  terms.budget_us = robot.swap.budget_share * 1e6 / rate_hz;
  double weakest_nm = robot.joints.empty() ? 1.0 : robot.joints.front().torque_max_nm;
  for (const robot::JointConfig& joint : robot.joints) {
    weakest_nm = std::min(weakest_nm, joint.torque_max_nm);
  }
  terms.shadow_tolerance_nm = 0.1 * weakest_nm;
  return terms;
}

bool is_term(const std::string& argument) {
  return std::any_of(std::begin(kArguments), std::end(kArguments),
                     [&](const Argument& each) { return argument == each.name; });
}

std::variant<Terms, Refusal> read_terms(const Json& args, const Terms& robot, double rate_hz) {
  Terms terms = robot;
  for (const Argument& each : kArguments) {
    const auto found = args.find(each.name);
    if (found == args.end() || found->is_null()) {
      continue;
    }
    const double most = std::min(each.most, each.most == kTickLimit ? 1e6 / rate_hz : each.most);
    const double value = found->is_number() ? found->get<double>() : std::nan("");
    const bool in_range = value >= each.least && value <= most;
    if (!in_range && !(each.or_zero && value == 0.0)) {
      return Refusal{"usage",
                     fmt::format("{} = {} is not {}a number from {:g} to {:g} ({})", each.name, found->dump(),
                                 each.or_zero ? "0 or " : "", each.least, most, each.what),
                     "the running law is unchanged; leave it out to use the robot file's value"};
    }
    terms.*each.field = value;
  }
  return terms;
}

void put_terms(const Terms& terms, double rate_hz, wire::StageRequest& request) {
  request.budget_ns = terms.budget_ns();
  request.shadow_ticks = ticks(terms.shadow_s, rate_hz);
  request.blend_ticks = ticks(terms.blend_s, rate_hz);
  request.probation_ticks = ticks(terms.probation_s, rate_hz);
  request.shadow_tolerance_nm = terms.shadow_tolerance_nm;
  request.probation_error_ratio = terms.error_ratio;
}

}  // namespace lithe::swap
