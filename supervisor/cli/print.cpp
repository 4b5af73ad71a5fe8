// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/print.hpp"

#include <fmt/format.h>

#include <numbers>
#include <utility>

#include "supervisor/control/event_log.hpp"

namespace lithe::cli {
namespace {

constexpr double kDegPerRad = 180.0 / std::numbers::pi;

// A number that may be null, because JSON has no NaN.
double number(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<double>() : 0.0;
}

std::string word(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "-";
}

// ", 24.0 V, 1.2 A": what the joint's drive tells of itself; empty when it tells nothing.
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

// Nothing while all is well.
void print_health(const Json& health) {
  const std::pair<const char*, const char*> words[] = {{"plans_torn", "plans that never came whole"},
                                                       {"brain_violations", "broken commands of the Brain"},
                                                       {"control_violations", "broken commands of the supervisor"},
                                                       {"stage_violations", "broken requests to the Loader"}};
  std::string found;
  for (const auto& [key, text] : words) {
    if (const auto count = health.value(key, std::uint64_t{0}); count != 0) {
      found += fmt::format("{}{}: {}", found.empty() ? "" : ", ", text, count);
    }
  }
  if (!found.empty()) {
    fmt::print("  BROKEN MESSAGES since the start: {}\n", found);
  }
}

// What each bus carried, and what went wrong there, where anything did.
void print_buses(const Json& buses) {
  const std::pair<const char*, const char*> troubles[] = {
      {"refused", "refused"}, {"late", "late"},         {"malformed", "malformed"},
      {"errors", "errors"},   {"reopened", "reopened"},
  };
  for (const Json& bus : buses) {
    std::string found;
    for (const auto& [key, text] : troubles) {
      if (const auto count = bus.value(key, std::uint64_t{0}); count != 0) found += fmt::format(", {} {}", count, text);
    }
    fmt::print("  bus {:<12} {} frames out, {} in{}\n", word(bus, "name"), bus.value("sent", std::uint64_t{0}),
               bus.value("received", std::uint64_t{0}), found);
  }
}

std::string list(const Json& words) {
  std::string all;
  for (const Json& each : words) {
    all += (all.empty() ? "" : ", ") + (each.is_string() ? each.get<std::string>() : each.dump());
  }
  return all;
}

void print_warnings(const Json& from, const char* indent) {
  for (const Json& each : from.value("warnings", Json::array())) {
    fmt::print("{}warning: {}\n", indent, each.is_string() ? each.get<std::string>() : each.dump());
  }
}

// "last swap: gravity_pd confirmed, 31.8 ms from request to commit", or why not.
void print_last_swap(const Json& swap) {
  if (!swap.is_object()) {
    return;
  }
  const std::string law = word(swap, "law");
  std::string said = fmt::format("{} {}", law.empty() ? word(swap, "source") : law, word(swap, "verdict"));
  if (swap.contains("requested_to_committed_ms")) {
    said += fmt::format(", {:.1f} ms from request to commit", number(swap, "requested_to_committed_ms"));
  }
  if (swap.contains("reason")) {
    said += fmt::format(": {}", word(swap, "reason"));
  }
  fmt::print("  last swap: {}\n", said);
  if (swap.contains("state_not_carried")) {
    fmt::print("    State not carried: {}\n", list(swap["state_not_carried"]));
  }
  print_warnings(swap, "    ");
}

// "last parameters: kp_nm_rad = 40 refused: with the simulated robot ...".
void print_last_params(const Json& change) {
  if (!change.is_object()) {
    return;
  }
  std::string values;
  const Json asked = change.value("values", Json::object());
  for (const auto& [name, value] : asked.items()) {
    values += fmt::format("{}{} = {}", values.empty() ? "" : ", ", name, value.dump());
  }
  const std::string reason = change.contains("error") ? word(change["error"], "message") : change.value("reason", "");
  fmt::print("  last parameters: {} {}{}{}\n", values, word(change, "verdict"), reason.empty() ? "" : ": ", reason);
  print_warnings(change, "    ");
}

// Nothing while the Spine has nothing to prove.
void print_probation(const Json& probation) {
  if (const std::string of = word(probation, "of"); of == "law" || of == "params") {
    fmt::print("  on probation: {}{}\n", of == "law" ? "the law" : "its parameters",
               probation.value("unproven", false) ? ", unproven: the robot has moved too little to judge by" : "");
  }
}

// "last law fault: pid bad_access at pid.cpp:21, tick 4711".
void print_last_fault(const Json& faults) {
  if (!faults.is_array() || faults.empty()) {
    return;
  }
  const Json& last = faults.back();
  const std::string where = last.contains("where") ? fmt::format(" at {}", word(last, "where")) : "";
  fmt::print("  last law fault: {} {}{}, tick {}\n", word(last, "law"), word(last, "kind"), where,
             last.value("tick", std::uint64_t{0}));
}

void print_quantiles(const char* name, const Json& q) {
  fmt::print("  {:<15} p50 {:8.2f}  p99 {:8.2f}  p99.9 {:8.2f}  max {:8.2f} us\n", name, number(q, "p50"),
             number(q, "p99"), number(q, "p999"), number(q, "max"));
}

// An older supervisor does not tell.
void print_core(const Json& cpus) {
  if (!cpus.contains("spine_core")) return;
  const Json& core = cpus["spine_core"];
  fmt::print("  the Spine's core: {}, {} ({})\n", cpus.value("spine", 0), word(core, "words"), word(core, "why"));
}

}  // namespace

void print_status(const Json& s) {
  fmt::print("robot {}: {}{}{}\n", word(s, "robot"), word(s, "mode"),
             s.value("recovering", false) ? " (joints are still outside their limits)" : "",
             word(s, "fault") == "none" ? "" : fmt::format(", fault {}", word(s, "fault")));
  fmt::print("  law {} ({}) at {:g} Hz, tick {}, plan {}\n", word(s, "law"), s.value("law_id", 0), number(s, "rate_hz"),
             s.value("tick", std::uint64_t{0}), word(s, "plan"));
  print_probation(s.value("probation", Json::object()));
  print_last_swap(s.value("last_swap", Json()));
  print_last_params(s.value("last_params", Json()));
  print_last_fault(s.value("law_faults", Json()));
  if (s.contains("records_trouble") && s["records_trouble"].is_string()) {
    fmt::print("  CERTIFICATES: {}\n", word(s, "records_trouble"));
  }
  fmt::print("  missed releases {}, late samples {}, Brain {}\n", s.value("missed_releases", 0),
             s.value("late_samples", 0),
             s["brain_age_ms"].is_null() ? "never seen" : fmt::format("{:.1f} ms ago", number(s, "brain_age_ms")));
  print_buses(s.value("buses", Json::array()));
  print_health(s.value("health", Json::object()));
  print_quantiles("release jitter", s["release_jitter_us"]);
  print_quantiles("hand-off", s["handoff_us"]);
  print_quantiles("law", s["law_us"]);
  print_quantiles("whole tick", s["tick_us"]);
  for (const Json& joint : s["joints"]) {
    std::string problems;
    for (const Json& each : joint["problems"]) {
      problems += " " + each.get<std::string>();
    }
    const Json& drive = joint["drive"];
    if (!joint["problems"].empty() && drive.is_string()) problems += " (drive: " + drive.get<std::string>() + ")";
    if (const std::string fault = joint.value("fault", "none"); fault != "none") problems += ", " + fault;
    if (const std::string rung = joint.value("rung", "law"); rung != "law") {
      const std::string group = joint.value("group", "");
      problems += fmt::format(" [{}{}]", group.empty() ? "" : group + ": ", rung);
    }
    fmt::print("  {:<12} {:9.2f} deg  (setpoint {:9.2f})  {:8.1f} deg/s  {:7.3f} Nm  drive {}{}\n", word(joint, "name"),
               number(joint, "position_rad") * kDegPerRad, number(joint, "setpoint_position_rad") * kDegPerRad,
               number(joint, "velocity_rad_s") * kDegPerRad, number(joint, "torque_nm"), drive_words(joint), problems);
  }
  print_core(s.value("cpus", Json::object()));
  if (word(s, "gates") == "open") {
    fmt::print("  THE GATES ARE OPEN: laws are neither admitted nor tried\n");
  }
  if (const std::string lost = s.value("lost", ""); !lost.empty()) {
    fmt::print("  this machine could not give: {}\n", lost);
  }
  fmt::print("  Spine pid {}, supervisor pid {}, compile service pid {}\n", s.value("spine_pid", 0),
             s.value("supervisor_pid", 0), s.value("lawd_pid", 0));
}

void print_command(const std::string& verb, const Json& result) {
  fmt::print("{}: mode {} at tick {}{}\n", verb, word(result, "mode"), result.value("tick", std::uint64_t{0}),
             result.contains("law") ? fmt::format(", law {}", word(result, "law")) : "");
}

void print_swap(const Json& c) {
  fmt::print(
      "law {} committed at tick {}: compiled in {:.0f} ms{}, loaded in {:.1f} ms, {:.0f} ms from request to commit, "
      "{} releases missed\n",
      word(c, "law"), c.value("commit_tick", std::uint64_t{0}), number(c, "compile_ms"),
      c.value("cached", false) ? " (cached)" : "", number(c, "load_ms"), number(c, "requested_to_committed_ms"),
      c.value("missed_releases", std::uint64_t{0}));
  if (c.contains("record_lost")) {
    fmt::print("its certificate is not on disk yet: {}\n", word(c, "record_lost"));
  }
  if (c.contains("state_not_carried")) {
    fmt::print("State not carried: {}\n", list(c["state_not_carried"]["fields"]));
  }
  print_warnings(c.value("trial", Json::object()), "");
}

void print_params(const Json& params) {
  fmt::print("law {}\n", word(params, "law"));
  for (const Json& each : params["params"]) {
    fmt::print("  {:<24} {:12.6g}   [{:g}, {:g}]\n", word(each, "name"), number(each, "value"), number(each, "min"),
               number(each, "max"));
  }
  print_warnings(params, "");
}

void print_check(const Json& result) {
  const Json law = result.value("law", Json::object());
  fmt::print("law {} is fine: compiled in {:.0f} ms{}, dry run passed\n", word(law, "name"),
             number(result, "compile_ms"), result.value("cached", false) ? " (cached)" : "");
  for (const Json& each : law.value("params", Json::array())) {
    fmt::print("  {:<24} {:12.6g}   [{:g}, {:g}]\n", word(each, "name"), number(each, "value"), number(each, "min"),
               number(each, "max"));
  }
}

void print_laws(const Json& laws) {
  for (const Json& each : laws["files"]) {
    fmt::print("  {:<20} {}\n", word(each, "name"), word(each, "about"));
  }
  for (const Json& each : laws["resident"]) {
    fmt::print("in the Spine: {} ({}){}\n", word(each, "law"), each.value("law_id", 0),
               each.value("active", false) ? ", running" : "");
  }
}

void print_events(const Json& events) {
  if (const auto lost = events.value("lost", std::uint64_t{0}); lost != 0) {
    fmt::print("({} older events are gone)\n", lost);
  }
  for (const Json& each : events["events"]) {
    fmt::print("{:>6}  {:14.6f} s  {}\n", each.value("cursor", std::uint64_t{0}),
               static_cast<double>(each.value("t_ns", std::int64_t{0})) * 1e-9, control::event_line(each));
  }
}

}  // namespace lithe::cli
