// SPDX-License-Identifier: Apache-2.0
#include "sim/fault_request.hpp"

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>

namespace lithe::simulator {
namespace {

using Json = nlohmann::json;
using Kind = FaultRequest::Kind;
using hal::InjectedFault;

struct Row {
  std::string_view word;
  Kind kind;
  InjectedFault injected{};
};
constexpr Row kKinds[] = {{"drop", Kind::drop},
                          {"corrupt", Kind::corrupt},
                          {"duplicate", Kind::duplicate},
                          {"replay", Kind::replay},
                          {"delay", Kind::delay},
                          {"bus_off", Kind::bus_off},
                          {"unplug", Kind::unplug},
                          {"reset", Kind::injected, InjectedFault::power_loss},
                          {"watchdog", Kind::injected, InjectedFault::watchdog_trip},
                          {"over_temperature", Kind::injected, InjectedFault::over_temperature},
                          {"encoder", Kind::injected, InjectedFault::encoder_lost},
                          {"device_fault", Kind::injected, InjectedFault::device_fault},
                          {"homing", Kind::injected, InjectedFault::homing_lost},
                          {"register_map", Kind::injected, InjectedFault::other_map},
                          {"twin", Kind::twin},
                          {"wrong_id", Kind::wrong_id},
                          {"clear", Kind::clear}};
constexpr double kLongestS = 1e6;

bool is_share(Kind kind) { return kind <= Kind::replay; }

// A number between 0 and `most` into `value`, when the key is there.
Result<> number(const Json& json, const char* key, double most, double& value) {
  const auto found = json.find(key);
  if (found == json.end()) return done();
  if (!found->is_number() || !(found->get<double>() >= 0 && found->get<double>() <= most))
    return Error{std::string("\"") + key + "\" must be a number from 0 to " + Json(most).dump()};
  value = found->get<double>();
  return done();
}

Result<> name(const Json& json, const char* key, std::string& value) {
  const auto found = json.find(key);
  if (found == json.end()) return done();
  if (!found->is_string()) return Error{std::string("\"") + key + "\" must be a name from the robot file"};
  value = found->get<std::string>();
  return done();
}

Result<> fill(const Json& json, FaultRequest& order) {
  for (const auto& item : json.items()) {
    constexpr std::array kKnown{"fault", "bus", "device", "share", "ms", "on", "after_s", "for_s"};
    if (std::ranges::find(kKnown, item.key()) == kKnown.end())
      return Error{"there is no \"" + item.key() + "\"; there are bus, device, share, ms, on, after_s, for_s"};
  }
  double ms = 0;
  for (const Result<>& step :
       {name(json, "bus", order.bus), name(json, "device", order.device), number(json, "share", 1, order.amount),
        number(json, "ms", 1e3 * kLongestS, ms), number(json, "after_s", kLongestS, order.after_s),
        number(json, "for_s", kLongestS, order.for_s)}) {
    if (!step) return step.error();
  }
  if (const auto on = json.find("on"); on != json.end()) {
    if (!on->is_boolean()) return Error{"\"on\" must be true or false"};
    order.on = on->get<bool>();
  }
  // A key that would be ignored is an error.
  const auto useless = [&](const char* key, bool used) { return json.contains(key) && !used; };
  const bool all = order.kind == Kind::clear;
  if (useless("bus", !is_of_device(order.kind) && !all)) return Error{"\"bus\" is for faults of a bus; say \"device\""};
  if (useless("device", is_of_device(order.kind))) return Error{"\"device\" is for faults of a device; say \"bus\""};
  if (useless("share", is_share(order.kind))) return Error{"\"share\" is for faults of some frames"};
  if (useless("ms", order.kind == Kind::delay)) return Error{"\"ms\" is for \"delay\""};
  if (useless("on", !is_share(order.kind) && order.kind != Kind::delay && !all))
    return Error{"\"on\" is not for this; \"share\": 0 or \"ms\": 0 ends it"};
  if (is_share(order.kind) && !json.contains("share")) return Error{"say how many: \"share\", from 0 to 1"};
  if (order.kind == Kind::delay && !json.contains("ms")) return Error{"say how long: \"ms\""};
  if (order.kind == Kind::delay) order.amount = 1e-3 * ms;
  return done();
}

}  // namespace

Result<FaultRequest> parse_order(std::string_view line) {
  const Json json = Json::parse(line, nullptr, false);
  if (!json.is_object()) return Error{"not a JSON object; for example {\"fault\": \"drop\", \"share\": 0.1}"};
  const auto fault = json.find("fault");
  FaultRequest order;
  std::string words;
  bool known = false;
  for (const auto& [word, kind, injected] : kKinds) {
    words += (words.empty() ? "" : ", ") + std::string(word);
    if (fault == json.end() || !fault->is_string() || fault->get<std::string>() != word) continue;
    order.kind = kind;
    order.injected = injected;
    known = true;
  }
  if (!known) return Error{"\"fault\" must be one of " + words};
  if (Result<> filled = fill(json, order); !filled) return filled.error();
  return order;
}

bool is_of_device(Kind kind) { return kind >= Kind::injected && kind <= Kind::wrong_id; }

FaultRequest undone(const FaultRequest& order) {
  FaultRequest end = order;
  end.amount = end.after_s = end.for_s = 0;
  end.on = false;
  return end;
}

}  // namespace lithe::simulator
