// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/swap_words.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "supervisor/link/spine_link.hpp"

namespace lithe::control {

using swap::Json;
using swap::Refusal;

std::optional<Refusal> wrong_param(const Json& params, const Json& law) {
  for (const auto& [name, value] : params.items()) {
    const Json known = law.value("params", Json::array());
    const auto found = std::find_if(known.begin(), known.end(),
                                    [&name = name](const Json& each) { return each.value("name", "") == name; });
    if (found == known.end()) {
      return Refusal{"unknown_param", fmt::format("the new law has no parameter '{}'", name), "leave it out"};
    }
    if (!value.is_number() || !(value >= (*found)["min"]) || !(value <= (*found)["max"])) {
      return Refusal{"refused_range",
                     fmt::format("{} = {} is outside [{}, {}]", name, value.dump(), (*found)["min"].dump(),
                                 (*found)["max"].dump()),
                     "the running law is unchanged; choose a value inside the range"};
    }
  }
  return std::nullopt;
}

Json all_params(const Json& params, const Json& law) {
  Json values = Json::object();
  for (const Json& each : law.value("params", Json::array())) {
    const std::string name = each.value("name", "");
    values[name] = params.value(name, each.value("value", 0.0));
  }
  return values;
}

void put_params(const Json& params, const Json& law, wire::StageRequest& request) {
  std::uint32_t index = 0;
  for (const Json& each : law.value("params", Json::array())) {
    const auto asked = params.find(each.value("name", ""));
    if (asked != params.end() && request.param_count < wire::kNparam) {
      request.param_index[request.param_count] = index;
      request.param_value[request.param_count++] = asked->get<double>();
    }
    ++index;
  }
}

Refusal stage_refusal(wire::StageResult result, const std::string& words) {
  const std::string code(to_string(result));
  const char* next = result == wire::StageResult::busy || result == wire::StageResult::slots_full
                         ? "another swap is under way in the Spine; try again"
                         : "the running law is unchanged; lithe law check tells more";
  return {code, words.empty() ? fmt::format("the Loader refused the law: {}", code) : words, next};
}

Json facts_of(const Json& result) {
  Json facts = Json::object();
  for (const char* key :
       {"object_sha256", "placeable_sha256", "toolchain", "gates", "steps_ms", "dry_step_max_ns", "warnings"}) {
    if (result.contains(key)) {
      facts[key] = result[key];
    }
  }
  return facts;
}

std::int64_t admission_ns(const Json& compiled) {
  double ms = 0.0;
  if (!compiled.value("cached", false)) {
    for (const Json& gate : compiled.value("gates", Json::array())) {
      ms += gate.value("ms", 0.0);
    }
  }
  return static_cast<std::int64_t>(ms * 1e6);
}

Json not_carried_json(const wire::Event& event) {
  const std::string text = text_of(event.text);  // "a, b: why"
  const std::size_t end = text.find(": ");
  Json fields = Json::array();
  for (std::size_t at = 0; at < std::min(end, text.size());) {
    const std::size_t comma = std::min({text.find(", ", at), end, text.size()});
    fields.push_back(text.substr(at, comma - at));
    at = comma + 2;
  }
  return {{"tick", event.tick},
          {"count", event.value},
          {"fields", std::move(fields)},
          {"why", end == std::string::npos ? "" : text.substr(end + 2)}};
}

Json shadow_json(const wire::ShadowReport& report) {
  const std::size_t joints = std::min<std::size_t>(report.joint_count, wire::kNj);
  return {{"from_tick", report.from_tick},
          {"ticks", report.ticks},
          {"faults", report.faults},
          {"most_ns", report.most_ns},
          {"mean_ns", report.mean_ns},
          {"most_nm", std::vector<double>(report.most_nm.begin(), report.most_nm.begin() + joints)},
          {"rms_nm", std::vector<double>(report.rms_nm.begin(), report.rms_nm.begin() + joints)}};
}

Json summary_of(const Json& certificate) {
  Json out = Json::object();
  for (const char* key :
       {"request_id", "law", "source", "verdict", "commit_tick", "requested_to_committed_ms", "refused_after"}) {
    if (certificate.contains(key)) {
      out[key] = certificate[key];
    }
  }
  if (certificate.contains("state_not_carried")) {
    out["state_not_carried"] = certificate["state_not_carried"]["fields"];
  }
  if (const Json trial = certificate.value("trial", Json::object()); !trial.value("warnings", Json::array()).empty()) {
    out["warnings"] = trial["warnings"];
  }
  const Json reasons = certificate.value("reasons", Json::object());
  if (certificate.contains("error")) {
    out["reason"] = certificate["error"].value("message", "");
  } else if (reasons.contains("rolled_back")) {
    out["reason"] = reasons["rolled_back"];
  } else if (certificate.value("verdict", "") == "unproven") {
    out["reason"] = reasons.value("unproven", "");
  }
  return out;
}

}  // namespace lithe::control
