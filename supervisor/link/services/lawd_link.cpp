// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/services/lawd_link.hpp"

#include <fmt/format.h>

#include <utility>

namespace lithe::control {
namespace {

// lawd names the stage that failed; the first error, with file and line, becomes the message.
Refusal refusal_of(const Json& answer) {
  const std::string stage = answer.value("stage", "compile");
  const std::string text = answer.value("text", "");
  const Json diagnostics = answer.value("diagnostics", Json::array());
  std::string message = text.substr(0, text.find('\n'));
  for (const Json& each : diagnostics) {
    if (each.value("severity", "") == "error" || each.value("severity", "") == "fatal error") {
      message = each.value("file", "?");
      for (const char* place : {"line", "column"})  // an unknown position is left out
        if (each.value(place, 0) > 0) message += fmt::format(":{}", each.value(place, 0));
      message += ": " + each.value("message", "");
      break;
    }
  }
  if (message.empty()) message = "the compile service gave no reason";
  Json detail = {{"stage", stage}, {"diagnostics", diagnostics}, {"text", text}};
  for (const char* key : {"gates", "cleaned"})
    if (answer.contains(key)) detail[key] = answer[key];
  const std::string next = answer.value("next", "the running law is unchanged; correct the source and swap again");
  return {answer.value("starved", false) ? "compile_starved" : stage + "_failed", message, next, detail};
}

// lawd's own answer, or a refusal in its place.
ServiceLink::Callback judged(ServiceLink::Callback callback) {
  return [callback = std::move(callback)](const Answer& answer) {
    const Json* json = std::get_if<Json>(&answer);
    if (json == nullptr) return callback(answer);
    if (!json->value("ok", false)) return callback(refusal_of(*json));
    Json result = *json;
    result.erase("ok");
    callback(result);
  };
}

}  // namespace

LawdLink::LawdLink(std::string program, std::vector<int> cpus, std::size_t joints, double compile_s)
    : ServiceLink(
          "lawd", "compile service", "compile_starved",
          {.argv = {std::move(program), fmt::format("{}", compile_s)}, .idle_priority = true, .cpus = std::move(cpus)}),
      joints_(joints),
      limit_ns_(static_cast<std::int64_t>(3e9 * compile_s)) {}

Json LawdLink::compile_request(const LawText& law) const {
  Json request = {{"verb", "compile"}, {"name", law.name}, {"source", law.source}, {"joints", joints_}};
  if (!gates_) {
    request["admit"] = false;
    request["dry_run"] = false;
  } else if (law.budget_ns != 0) {
    request["budget_ns"] = law.budget_ns;
  }
  return request;
}

void LawdLink::compile(const LawText& law, Callback callback, std::int64_t now_ns) {
  ask(compile_request(law), Turn::in_line, limit_ns_, judged(std::move(callback)), now_ns);
}

void LawdLink::check(const LawText& law, Callback callback, std::int64_t now_ns) {
  if (idle_waiting() >= kMaxChecks) {
    return callback(Refusal{"busy", fmt::format("{} laws wait already to be checked", idle_waiting()),
                            "try again when one of them is answered"});
  }
  ask(compile_request(law), Turn::idle, limit_ns_, judged(std::move(callback)), now_ns);
}

void LawdLink::place(const std::string& hash, std::uint32_t slot, PlacedCallback callback, std::int64_t now_ns) {
  const auto take = [slot, callback = std::move(callback)](const Answer& answer) {
    if (const auto* refusal = std::get_if<Refusal>(&answer)) return callback(*refusal);
    const Json& placed = std::get<Json>(answer);
    callback(Placed{slot, placed.value("code_bytes", std::uint32_t{0}), placed.value("entry", std::uint64_t{0}),
                    placed.value("image_hash", std::uint64_t{0}), placed.value("place_ms", 0.0)});
  };
  // The running check belongs to the law whose turn it is.
  ask({{"verb", "place"}, {"hash", hash}, {"slot", slot}}, Turn::next, limit_ns_, judged(take), now_ns);
}

void LawdLink::locate(const std::string& hash, std::uint64_t offset, bool placed, Callback callback,
                      std::int64_t now_ns) {
  ask({{"verb", "locate"}, {"hash", hash}, {"offset", offset}, {"placed", placed}}, Turn::in_line, limit_ns_,
      judged(std::move(callback)), now_ns);
}

}  // namespace lithe::control
