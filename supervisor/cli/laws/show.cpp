// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/laws/show.hpp"

#include <fmt/format.h>

#include <initializer_list>

namespace lithe::cli {
namespace {

void row(const char* name, const std::string& text) {
  if (!text.empty()) fmt::print("  {:<13} {}\n", name, text);
}

// The value at the end of a path of keys; null when a key is missing.
const Json& at(const Json& from, std::initializer_list<const char*> path) {
  static const Json nothing = nullptr;
  const Json* found = &from;
  for (const char* name : path) {
    if (!found->is_object() || !found->contains(name)) return nothing;
    found = &(*found)[name];
  }
  return *found;
}

std::string text(const Json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (value.is_number_float()) return fmt::format("{:.4g}", value.get<double>());
  return value.is_null() ? "-" : control::dump_line(value);
}

// A value that was not measured is shown as unknown, not as 0.
std::string decimals(const Json& value, int count) {
  return value.is_number() ? fmt::format("{:.{}f}", value.get<double>(), count) : "-";
}

double number(const Json& value) { return value.is_number() ? value.get<double>() : 0.0; }

// The reason of a stage; empty = none.
std::string reason(const Json& c, const char* stage) {
  const Json& found = at(c, {"reasons", stage});
  return found.is_string() ? found.get<std::string>() : "";
}

// All fields of a section: "kind bad_access, tick 512".
std::string all_of(const Json& section) {
  std::string words;
  if (section.is_object())
    for (const auto& [name, value] : section.items())
      words += fmt::format("{}{} {}", words.empty() ? "" : ", ", name, text(value));
  return words;
}

void print_origin(const Json& c) {
  row("source", fmt::format("{}, sha256 {}", text(at(c, {"source"})), text(at(c, {"source_sha256"}))));
  if (const Json& object = at(c, {"object_sha256"}); !object.is_null())
    row("object", fmt::format("sha256 {}{}", text(object), at(c, {"cached"}) == true ? " (compiled before)" : ""));
  if (const Json& tools = at(c, {"toolchain"}); tools.is_object()) {
    row("toolchain", fmt::format("{}; {}", text(at(tools, {"compiler"})), text(at(tools, {"linker"}))));
    row("flags", text(at(tools, {"flags"})));
  }
}

void print_split(const Json& c) {
  std::string parts;
  for (const auto& [name, value] : at(c, {"split_ms"}).items())
    parts += fmt::format("{}{} {:.1f}", parts.empty() ? "" : ", ", name, number(value));
  if (const Json& whole = at(c, {"requested_to_committed_ms"}); whole.is_number())
    row("took", fmt::format("{:.1f} ms from request to commit: {}", number(whole), parts));
  else if (!parts.empty())
    row("took", fmt::format("{} ms, as far as it came", parts));
}

void print_gates(const Json& c) {
  const Json& refused = at(c, {"error", "detail", "gates"});  // of a law that admission refused
  const Json& gates = refused.is_array() ? refused : at(c, {"gates"});
  if (!gates.is_array()) return row("gates", reason(c, "admitted"));
  std::size_t passed = 0;
  std::string failed;
  for (const Json& gate : gates)
    if (at(gate, {"ok"}) == true)
      ++passed;
    else
      failed += fmt::format("; {}: {}", text(at(gate, {"gate"})), text(at(gate, {"detail"})));
  row("gates", fmt::format("{} of {} passed{}", passed, gates.size(), failed));
}

void print_trial(const Json& c) {
  const Json& trial = at(c, {"trial"});
  if (!trial.is_object()) return row("trial", reason(c, "tried"));
  std::string words =
      fmt::format("{} in {:.0f} ms", at(trial, {"ok"}) == true ? "passed" : "refused", number(at(trial, {"ms"})));
  if (const Json& timing = at(trial, {"report", "timing"}); at(timing, {"done"}) == true) {
    words += fmt::format("; a step takes {:.0f} ns of {:.0f} allowed (p99.9, best of 3), measured at most {:.0f} ns",
                         number(at(timing, {"p999_ns"})), number(at(timing, {"budget_ns"})),
                         number(at(timing, {"worst_ns"})));
  }
  row("trial", words);
  for (const Json& each : at(trial, {"warnings"})) row("warning", text(each));
  for (const Json& each : at(trial, {"hints"})) row("hint", text(each));
}

void print_window(const char* name, const Json& measured, const char* key) {
  const auto side = [&](const char* which) {
    const Json& found = at(measured, {which, key});
    return fmt::format("p50 {} max {} us", decimals(at(found, {"p50_us"}), 2), decimals(at(found, {"max_us"}), 2));
  };
  row(name, fmt::format("before {}, after {}", side("before"), side("after")));
}

void print_commit(const Json& c) {
  if (!at(c, {"commit_tick"}).is_number()) return;
  row("placed", reason(c, "placed"));
  row("shadow", all_of(at(c, {"shadow"})));
  row("committed", fmt::format("at tick {} as law {}; releases missed on the way: {}", text(at(c, {"commit_tick"})),
                               text(at(c, {"law_id"})), text(at(c, {"missed_releases"}))));
  const Json& measured = at(c, {"measured"});
  if (!measured.is_object()) return;
  row("first call", text(at(measured, {"first_call_ns"})) + " ns");
  const auto core = [&](const char* key) { return text(at(measured, {"core", key})); };
  row("Spine's core", fmt::format("page faults {} (major {}); interrupts: TLB {}, function call {}, reschedule {}",
                                  core("minor_faults"), core("major_faults"), core("tlb"), core("cal"), core("res")));
  print_window("jitter", measured, "release_jitter");
  print_window("hand-off", measured, "handoff");
  const Json& after = at(measured, {"after"});
  row("largest step",
      fmt::format("{} N m in a tick, at most {} allowed (before the commit {})",
                  decimals(at(after, {"largest_step_nm"}), 4), decimals(at(after, {"slew_bound_nm"}), 4),
                  decimals(at(measured, {"before", "largest_step_nm"}), 4)));
}

// Old law beside new, per joint.
void print_control(const Json& c) {
  const Json& control = at(c, {"control"});
  if (!control.is_object()) return;
  for (const Json& joint : at(control, {"joints"})) {
    const auto pair = [&](const char* key, int digits) {
      const auto side = [&](const char* which) { return decimals(at(joint, {which, key}), digits); };
      return fmt::format("{} -> {}", side("before"), side("after"));
    };
    row(("joint " + text(at(joint, {"joint"}))).c_str(),
        fmt::format("rms error {} rad (predicted {}), largest {}; torque rms {} N m, largest {}",
                    pair("rms_error_rad", 4), decimals(at(joint, {"predicted_rms_error_rad"}), 4),
                    pair("max_error_rad", 4), pair("rms_torque_nm", 3), pair("max_torque_nm", 3)));
  }
  for (const Json& each : at(control, {"seen"})) row("seen", text(each));
}

std::string probation(const Json& c, double lasts_s) {
  if (lasts_s == 0) return "none";
  const Json& times = at(c, {"times_ns"});
  const char* how = !at(times, {"confirmed"}).is_null()     ? "passed"
                    : !at(times, {"rolled_back"}).is_null() ? "not passed"
                    : !at(times, {"retired"}).is_null()     ? "not ended"
                    : !at(times, {"unproven"}).is_null()    ? "unproven: the robot has moved too little to judge by"
                                                            : "under way";
  const Json& cut = at(c, {"probation"});
  return fmt::format("{:.3g} s: {}", lasts_s, cut.is_string() ? text(cut) : how);
}

void print_terms(const Json& c) {
  const Json& terms = at(c, {"terms"});
  if (!terms.is_object() || !at(c, {"commit_tick"}).is_number()) return;
  row("blend", fmt::format("{:.0f} ms", number(at(terms, {"blend_s"})) * 1e3));
  row("probation", probation(c, number(at(terms, {"probation_s"}))));
}

void print_end(const Json& c) {
  row("not carried", all_of(at(c, {"state_not_carried"})));
  row("params", all_of(at(c, {"params"})));
  for (const Json& each : at(c, {"param_changes"})) {
    const Json& error = at(each, {"error", "message"});
    row("params set", fmt::format("{} {}{}", all_of(at(each, {"values"})), text(at(each, {"verdict"})),
                                  error.is_string() ? ": " + text(error) : ""));
  }
  row("fault", all_of(at(c, {"fault"})));
  row("rolled back", all_of(at(c, {"rolled_back"})));
  if (const Json& error = at(c, {"error"}); error.is_object()) {
    row("refused", fmt::format("after {}, {}: {}", text(at(c, {"refused_after"})), text(at(error, {"code"})),
                               text(at(error, {"message"}))));
    row("next", text(at(error, {"next"})));
  }
  row("retired", reason(c, "retired"));
}

}  // namespace

void print_certificate(const std::string& file, const Json& c) {
  const std::string law = text(at(c, {"law"}));
  fmt::print("{}: {}, {}\n", file, law.empty() ? text(at(c, {"source"})) : "law " + law, text(at(c, {"verdict"})));
  row("request", text(at(c, {"request_id"})));
  print_origin(c);
  print_split(c);
  print_gates(c);
  print_trial(c);
  print_commit(c);
  print_control(c);
  print_terms(c);
  print_end(c);
}

void print_chain(const Json& chain) {
  fmt::print("{}: {} certificates, {} writings: ", text(at(chain, {"folder"})), text(at(chain, {"certificates"})),
             text(at(chain, {"writings"})));
  const Json& problems = at(chain, {"problems"});
  fmt::print("{}\n", problems.empty() ? "the chain holds" : "THE CHAIN IS BROKEN");
  for (const Json& each : problems) fmt::print("  {:<8} {}\n", text(at(each, {"what"})), text(at(each, {"text"})));
  if (number(at(chain, {"cut"})) > 0)
    fmt::print("  cut short by a full disk or a crash, which breaks nothing: {}\n", text(at(chain, {"cut"})));
}

}  // namespace lithe::cli
