// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/print.hpp"

#include <fmt/format.h>

#include "supervisor/cli/status_text.hpp"
#include "supervisor/events/event_log.hpp"

namespace lithe::cli {
namespace {

// A number that may be null, because JSON has no NaN.
double number(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<double>() : 0.0;
}

std::string word(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "-";
}

}  // namespace

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
    fmt::print("State not carried: {}\n", listed(c["state_not_carried"]["fields"]));
  }
  fmt::print("{}", warning_lines(c.value("trial", Json::object()), ""));
}

void print_params(const Json& params) {
  fmt::print("law {}\n", word(params, "law"));
  for (const Json& each : params["params"]) {
    fmt::print("  {:<24} {:12.6g}   [{:g}, {:g}]\n", word(each, "name"), number(each, "value"), number(each, "min"),
               number(each, "max"));
  }
  fmt::print("{}", warning_lines(params, ""));
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
