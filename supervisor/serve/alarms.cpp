// SPDX-License-Identifier: Apache-2.0
#include "spine/core/lookup.hpp"
#include "supervisor/serve/status.hpp"

#include <fmt/format.h>

#include <numbers>
#include <string>
#include <utility>

namespace lithe::control {
namespace {

constexpr double kDegPerRad = 180.0 / std::numbers::pi;
constexpr double kNearRad = 0.1;        // of a position limit: there the guard begins to fade torque
constexpr double kFrozenAfterMs = 500;  // much longer than a tick that got too little processor time

std::string word(const Json& from, const char* key) {
  const auto found = from.find(key);
  return found != from.end() && found->is_string() ? found->get<std::string>() : "";
}

bool has_number(const Json& from, const char* key) {
  const auto found = from.find(key);
  return found != from.end() && found->is_number();
}

class Alarms {
 public:
  void stop(const std::string& text) { stops_.push_back({{"level", "stop"}, {"text", text}}); }
  void warn(const std::string& text) { warnings_.push_back({{"level", "warn"}, {"text", text}}); }
  Json all() const {
    Json all = stops_;
    for (const Json& each : warnings_) all.push_back(each);
    return all;
  }

 private:
  Json stops_ = Json::array(), warnings_ = Json::array();
};

// "velocity_limit at joint wrist: 19.3 rad/s, allowed 18.8 [tick 51]; next: what to change".
std::string what_stopped(const Json& status, const std::string& fault) {
  const Json stop = status.value("stopped_by", Json());
  if (!stop.is_object()) return fault + "; what happened: lithe events; then: lithe reset";
  const std::string text = word(stop, "text"), next = word(stop, "next");
  return fmt::format("{} [tick {}]; next: {}", text.starts_with(fault) ? text : fault + ": " + text,
                     stop.value("tick", std::uint64_t{0}), next.empty() ? "lithe events, lithe reset" : next);
}

void see_mode(const Json& status, Alarms& out) {
  const std::string mode = word(status, "mode"), fault = word(status, "fault");
  const bool faulty = !fault.empty() && fault != "none";
  if (mode == "estop")
    out.stop(
        status.contains("estop_held_by")
            ? fmt::format("the e-stop is held by the Brain, {}; find out why, then reset from there (robot.reset(); a "
                          "gateway's client: the verb reset), or end it, then: lithe reset",
                          word(status, "estop_held_by"))
            : "the e-stop is latched; find out why, then: lithe reset");
  else if (mode == "safe_stop" && !faulty)
    out.warn("brakes for disarm or reset; the drives are off then");
  else if (mode == "safe_stop")
    out.stop("safe stop by " + what_stopped(status, fault));
  else if (faulty)
    out.stop("latched fault: " + what_stopped(status, fault));
  if (has_number(status, "age_ms") && status["age_ms"].get<double>() > kFrozenAfterMs) {
    out.stop(fmt::format(
        "THE SPINE DOES NOT TICK: its last tick is {:.1f} s old (pid {}: stopped, or without processor time?)",
        status["age_ms"].get<double>() * 1e-3, status.value("spine_pid", 0)));
  }
}

// Distance of the joint to its nearer limit [rad], and which limit that is.
void see_limits(const Json& joint, Alarms& out) {
  for (const char* key : {"position_rad", "position_min_rad", "position_max_rad"})
    if (!has_number(joint, key)) return;
  const double at = joint["position_rad"];
  const double up = joint["position_max_rad"].get<double>() - at, down = at - joint["position_min_rad"].get<double>();
  const bool upper = up < down;
  const double left = upper ? up : down;
  if (!(left < kNearRad)) return;
  const double limit = joint[upper ? "position_max_rad" : "position_min_rad"];
  const std::string which =
      fmt::format("its {} limit of {:.3f} rad ({:.1f} deg)", upper ? "upper" : "lower", limit, limit * kDegPerRad);
  const std::string name = word(joint, "name");
  if (left < 0) {
    out.stop(
        fmt::format("{} is {:.3f} rad ({:.1f} deg) beyond {}: lithe recover", name, -left, -left * kDegPerRad, which));
  } else {
    out.warn(fmt::format("{} is {:.3f} rad ({:.1f} deg) from {}", name, left, left * kDegPerRad, which));
  }
}

void see_joint(const Json& joint, Alarms& out) {
  const std::string name = word(joint, "name"), fault = word(joint, "fault");
  if (!fault.empty() && fault != "none") out.stop(fmt::format("{}: fault {}", name, fault));
  const Json all = joint.value("problems", Json::array());
  const std::string problems = joined(all, [](const Json& each) { return each.get<std::string>(); });
  if (!problems.empty()) {
    const std::string drive = word(joint, "drive");
    out.stop(fmt::format("{}: {}{}", name, problems, drive.empty() ? "" : fmt::format(" (drive: {})", drive)));
  }
  see_limits(joint, out);
}

// The watch of the running law.
void see_law(const Json& status, Alarms& out) {
  const Json seen = status.value("law_suspected", Json());
  if (!seen.is_object()) return;
  out.warn(fmt::format("the law {}: {} [tick {}]; next: {}", word(status, "law"), word(seen, "text"),
                       seen.value("tick", std::uint64_t{0}), word(seen, "next")));
}

void see_health(const Json& status, Alarms& out) {
  const Json health = status.value("health", Json::object());
  const std::pair<const char*, const char*> words[] = {{"plans_torn", "plans that never came whole"},
                                                       {"brain_violations", "broken commands of the Brain"},
                                                       {"control_violations", "broken commands of the supervisor"},
                                                       {"stage_violations", "broken requests to the Loader"}};
  std::string found;
  for (const auto& [key, text] : words)
    if (const auto count = health.value(key, std::uint64_t{0}); count != 0)
      found += fmt::format("{}{}: {}", found.empty() ? "" : ", ", text, count);
  if (!found.empty()) out.warn("BROKEN MESSAGES since the start: " + found);
}

}  // namespace

Json alarms_of(const Json& status) {
  Alarms out;
  see_mode(status, out);
  if (const std::string why = word(status, "not_ready"); !why.empty()) out.stop("NOT READY: " + why);
  see_law(status, out);
  for (const Json& joint : status.value("joints", Json::array())) see_joint(joint, out);
  if (word(status, "gates") == "open") out.warn("THE GATES ARE OPEN: laws are neither admitted nor tried");
  if (const std::string problem = word(status, "certificates_error"); !problem.empty())
    out.warn("CERTIFICATES: " + problem);
  if (const Json slow = status.value("throttled", Json::object()); slow.value("now", false))
    out.warn("THE PROCESSOR IS SLOWED DOWN (" + word(slow, "why") + "): ticks take longer; cool it, or lower rate_hz");
  see_health(status, out);
  return out.all();
}

}  // namespace lithe::control
