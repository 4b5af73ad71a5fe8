// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/robot/status_text.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <cstdlib>
#include <string_view>
#include <utility>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/robot/motion.hpp"

namespace lithe::cli {
namespace {

constexpr const char* kRed = "\x1b[1;31m";
constexpr const char* kYellow = "\x1b[33m";
constexpr const char* kPlain = "\x1b[0m";

Json part(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_object() ? *found : Json::object();
}

std::string colored(const Look& look, bool stop, const std::string& text) {
  return look.color ? (stop ? kRed : kYellow) + text + kPlain : text;
}

std::string alarm_lines(const Json& status, const Look& look) {
  std::string text;
  for (const Json& each : status.value("alarms", Json::array())) {
    const bool stop = word(each, "level") == "stop";
    text += "  " + colored(look, stop, fmt::format("{} {}", stop ? "ALARM  " : "warning", word(each, "text"))) + "\n";
  }
  return text;
}

// Empty when nothing is on probation.
std::string probation_line(const Json& status) {
  const Json probation = part(status, "probation");
  const std::string of = word(probation, "of");
  if (of != "law" && of != "params") return "";
  return fmt::format(
      "  on probation: {}{}\n", of == "law" ? "the law" : "its parameters",
      probation.value("unproven", false) ? ", unproven: the robot has moved too little to judge by" : "");
}

// "last swap: gravity_pd confirmed, 31.8 ms from request to commit", or why not.
std::string last_swap(const Json& status) {
  const Json swap = part(status, "last_swap");
  if (swap.empty()) return "";
  const std::string law = word(swap, "law");
  std::string said = fmt::format("{} {}", law.empty() ? word(swap, "source") : law, word(swap, "verdict"));
  if (swap.contains("requested_to_committed_ms"))
    said += fmt::format(", {:.1f} ms from request to commit", number(swap, "requested_to_committed_ms"));
  if (swap.contains("reason")) said += fmt::format(": {}", word(swap, "reason"));
  std::string text = fmt::format("  last swap: {}\n", said);
  if (swap.contains("state_not_carried"))
    text += fmt::format("    State not carried: {}\n", listed(swap["state_not_carried"]));
  return text + warning_lines(swap, "    ");
}

// "last parameters: kp_nm_rad = 40 refused: with the simulated robot ...".
std::string last_params(const Json& status) {
  const Json change = part(status, "last_params");
  if (change.empty()) return "";
  std::string values;
  const Json asked = part(change, "values");
  for (const auto& [name, value] : asked.items())
    values += fmt::format("{}{} = {}", values.empty() ? "" : ", ", name, value.dump());
  const std::string reason = change.contains("error") ? word(change["error"], "message") : change.value("reason", "");
  return fmt::format("  last parameters: {} {}{}{}\n", values, word(change, "verdict"), reason.empty() ? "" : ": ",
                     reason) +
         warning_lines(change, "    ");
}

// "last law fault: pid bad_access at pid.cpp:21, tick 4711".
std::string last_fault(const Json& status) {
  const Json faults = status.value("law_faults", Json::array());
  if (faults.empty()) return "";
  const Json& last = faults.back();
  const std::string where = last.contains("where") ? fmt::format(" at {}", word(last, "where")) : "";
  return fmt::format("  last law fault: {} {}{}, tick {}\n", word(last, "law"), word(last, "kind"), where,
                     last.value("tick", std::uint64_t{0}));
}

// An older supervisor does not report this.
std::string core_line(const Json& status) {
  const Json cpus = part(status, "cpus"), core = part(cpus, "spine_core");
  if (core.empty()) return "";
  const Json interrupts = part(core, "interrupts");
  return fmt::format("  the Spine's core: {}, {} ({})\n", cpus.value("spine", 0), word(core, "words"),
                     word(core, "why")) +
         (interrupts.empty() ? "" : fmt::format("    interrupts: {}\n", word(interrupts, "words")));
}

// Empty without a shield.
std::string shield_lines(const Json& status) {
  const Json shield = part(status, "shield");
  if (shield.empty()) return "";
  std::string text = fmt::format("    shield: {}\n", word(shield, "words"));
  for (const Json& note : shield.value("notes", Json::array()))
    text += fmt::format("      {}\n", note.get<std::string>());
  return text;
}

// Frames of each bus, and its errors if there were any.
std::string bus_lines(const Json& status) {
  const std::pair<const char*, const char*> failures[] = {
      {"refused", "refused"}, {"late", "late"},         {"malformed", "malformed"},
      {"errors", "errors"},   {"reopened", "reopened"},
  };
  std::string text;
  for (const Json& bus : status.value("buses", Json::array())) {
    std::string found;
    for (const auto& [key, name] : failures)
      if (const auto count = bus.value(key, std::uint64_t{0}); count != 0) found += fmt::format(", {} {}", count, name);
    text += fmt::format("  bus {:<12} {} frames out, {} in{}\n", word(bus, "name"), bus.value("sent", std::uint64_t{0}),
                        bus.value("received", std::uint64_t{0}), found);
  }
  return text;
}

std::string quantile_lines(const Json& status) {
  const std::pair<const char*, const char*> rows[] = {{"release jitter", "release_jitter_us"},
                                                      {"hand-off", "handoff_us"},
                                                      {"law", "law_us"},
                                                      {"whole tick", "tick_us"}};
  std::string text = fmt::format("  {:<15} {:>8} {:>8} {:>8} {:>8}\n", "time in us", "p50", "p99", "p99.9", "max");
  for (const auto& [name, key] : rows) {
    const Json q = part(status, key);
    text += fmt::format("  {:<15} {:8.2f} {:8.2f} {:8.2f} {:8.2f}\n", name, number(q, "p50"), number(q, "p99"),
                        number(q, "p999"), number(q, "max"));
  }
  return text;
}

// ", 24.0 V, 1.2 A": the values that the joint's drive reports; empty = none.
std::string drive_words(const Json& joint) {
  const std::pair<const char*, const char*> told[] = {
      {"drive_voltage_v", "V"}, {"drive_current_a", "A"}, {"drive_power_w", "W"}, {"drive_temperature_degc", "degC"}};
  std::string words = word(joint, "drive_state");
  for (const auto& [key, unit] : told) {
    const auto found = joint.find(key);
    if (found != joint.end() && found->is_number()) words += fmt::format(", {:.1f} {}", found->get<double>(), unit);
  }
  return words;
}

// The joint's problems, in its own row.
std::string problems_of(const Json& joint) {
  std::string text;
  const Json problems = joint.value("problems", Json::array());
  for (const Json& each : problems) text += " " + each.get<std::string>();
  if (!problems.empty() && word(joint, "drive") != "-") text += " (drive: " + word(joint, "drive") + ")";
  if (const std::string fault = joint.value("fault", "none"); fault != "none") text += ", " + fault;
  return text;
}

std::string rung_of(const Json& joint) {
  const std::string rung = joint.value("rung", "law"), group = joint.value("group", "");
  return rung == "law" ? "" : fmt::format(" [{}{}]", group.empty() ? "" : group + ": ", rung);
}

std::string joint_lines(const Json& status, const Look& look) {
  const double unit = look.radians ? 1.0 : kDegPerRad;
  const int digits = look.radians ? 4 : 2;
  const char* name = look.radians ? "rad" : "deg";
  std::string text = fmt::format("  {:<12} {:>10} {:>10} {:>10} {:>8}  {:>20}  {}\n", "joint", "position", "setpoint",
                                 "velocity", "torque", "limits", "drive");
  text += fmt::format("  {:<12} {:>10} {:>10} {:>10} {:>8}  {:>20}\n", "", name, name, fmt::format("{}/s", name), "N m",
                      name);
  for (const Json& joint : status.value("joints", Json::array())) {
    const std::string limits = joint.contains("position_min_rad")
                                   ? fmt::format("{:.{}f} .. {:.{}f}", number(joint, "position_min_rad") * unit, digits,
                                                 number(joint, "position_max_rad") * unit, digits)
                                   : "-";
    const std::string problems = problems_of(joint);
    text += fmt::format("  {:<12} {:10.{}f} {:10.{}f} {:10.{}f} {:8.3f}  {:>20}  {}{}{}\n", word(joint, "name"),
                        number(joint, "position_rad") * unit, digits, number(joint, "setpoint_position_rad") * unit,
                        digits, number(joint, "velocity_rad_s") * unit, digits, number(joint, "torque_nm"), limits,
                        drive_words(joint), problems.empty() ? "" : colored(look, true, problems), rung_of(joint));
  }
  return text;
}

std::string brain_words(const Json& s) {
  const auto known = [&](const char* name) { return s.contains(name) && s[name].is_number(); };
  if (known("brain_age_ms")) return fmt::format("{:.1f} ms ago", number(s, "brain_age_ms"));
  if (!known("brain_ahead_s")) return "never seen";
  return fmt::format(
      "heartbeats are {:.1f} s ahead of the Spine's clock: it has another time namespace (a container); "
      "start it in the robot's",
      number(s, "brain_ahead_s"));
}

}  // namespace

bool wants_color() {
  const char* never = std::getenv("NO_COLOR");
  const char* terminal = std::getenv("TERM");
  const bool dumb = terminal == nullptr || std::string_view(terminal) == "dumb";
  return ::isatty(STDOUT_FILENO) == 1 && !dumb && (never == nullptr || *never == '\0');
}

std::string status_text(const Json& s, const Look& look) {
  const bool stopped = word(s, "mode") == "estop" || word(s, "mode") == "safe_stop";
  std::string mode = word(s, "mode");
  if (s.value("recovering", false)) mode += " (joints are still outside their limits)";
  if (word(s, "fault") != "none" && word(s, "fault") != "-") mode += ", fault " + word(s, "fault");
  std::string text = fmt::format("robot {}: {}\n", word(s, "robot"), stopped ? colored(look, true, mode) : mode);
  text += alarm_lines(s, look);
  text += fmt::format("  law {} ({}) at {:g} Hz, tick {}, plan {}\n", word(s, "law"), s.value("law_id", 0),
                      number(s, "rate_hz"), s.value("tick", std::uint64_t{0}), word(s, "plan"));
  text += probation_line(s) + last_swap(s) + last_params(s) + last_fault(s);
  text += fmt::format("  missed releases {}, late samples {}, Brain {}\n", s.value("missed_releases", 0),
                      s.value("late_samples", 0), brain_words(s));
  text += bus_lines(s) + quantile_lines(s) + joint_lines(s, look) + core_line(s) + shield_lines(s);
  if (const std::string lost = s.value("lost", ""); !lost.empty())
    text += fmt::format("  this machine could not give: {}\n", lost);
  return text + fmt::format("  Spine pid {}, supervisor pid {}, compile service pid {}\n", s.value("spine_pid", 0),
                            s.value("supervisor_pid", 0), s.value("lawd_pid", 0));
}

}  // namespace lithe::cli
