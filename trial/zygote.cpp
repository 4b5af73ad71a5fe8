// SPDX-License-Identifier: Apache-2.0
#include "trial/zygote.hpp"

#include <unistd.h>

#include <algorithm>
#include <charconv>
#include <cstring>
#include <utility>

#include "spine/arena/arena.hpp"
#include "spine/robot/robot.hpp"
#include "trial/child.hpp"
#include "trial/sections/safe_ride.hpp"
#include "trial/sections/sections.hpp"
#include "trial/verdict.hpp"

namespace lithe::trial {
namespace {

using nlohmann::json;

constexpr int kBoxMs = 150, kLeastBoxMs = 20, kMostBoxMs = 5000;

json refuse(const char* stage, const std::string& reason) {
  return {{"ok", false}, {"stage", stage}, {"reason", reason}};
}

std::string text(const json& request, const char* key) {
  const auto found = request.find(key);
  return found != request.end() && found->is_string() ? found->get<std::string>() : "";
}

std::int64_t number(const json& request, const char* key, std::int64_t otherwise) {
  const auto found = request.find(key);
  if (found == request.end() || !found->is_number()) return otherwise;
  return found->is_number_unsigned() ? static_cast<std::int64_t>(found->get<std::uint64_t>())
                                     : static_cast<std::int64_t>(found->get<double>());
}

// Addresses and hashes have 64 bits, which not every reader of JSON keeps: as a number, or as hexadecimal text.
std::uint64_t word(const json& request, const char* key) {
  const auto found = request.find(key);
  if (found == request.end()) return 0;
  if (found->is_number_unsigned()) return found->get<std::uint64_t>();
  std::string digits = text(request, key);
  if (digits.starts_with("0x")) digits.erase(0, 2);
  std::uint64_t value = 0;
  std::from_chars(digits.data(), digits.data() + digits.size(), value, 16);
  return value;
}

// "" or what is wrong with the request.
std::string read_order(const json& request, const Setting& setting, Order& order) {
  const std::string object = text(request, "object");
  order.stage.slot = static_cast<std::uint32_t>(std::clamp<std::int64_t>(number(request, "slot", 0), 0, UINT32_MAX));
  if (object.empty() && order.stage.slot == 0) return "try needs \"object\", or \"slot\" and what place answered";
  if (object.size() >= order.stage.path.size()) return "the path of the object is too long";
  std::copy(object.begin(), object.end(), order.stage.path.begin());
  order.stage.code_bytes = static_cast<std::uint32_t>(number(request, "code_bytes", 0));
  order.stage.entry = word(request, "entry");
  order.stage.image_hash = word(request, "image_hash");
  const auto budget_ns = static_cast<double>(setting.period_ns()) * setting.robot.swap.budget_share;
  order.budget_ns = number(request, "budget_ns", 0);
  if (order.budget_ns <= 0) order.budget_ns = static_cast<std::int64_t>(budget_ns);
  order.box_ms = static_cast<int>(std::clamp<std::int64_t>(number(request, "box_ms", kBoxMs), kLeastBoxMs, kMostBoxMs));
  order.recording = text(request, "robot");
  const auto params = request.find("params");
  if (params == request.end() || params->is_null()) return "";
  if (!params->is_object()) return "\"params\" must be an object of numbers";
  for (const auto& [name, value] : params->items()) {
    if (!value.is_number()) return "\"params\" must be an object of numbers";
    order.params.emplace_back(name, value.get<double>());
  }
  return "";
}

}  // namespace

Result<Zygote> Zygote::make(const std::string& robot_path, int arena_fd) {
  auto robot = robot::load_robot(robot_path);
  if (!robot) return robot.error();
  Setting setting;
  setting.robot = std::move(*robot);
  setting.clock = RawClock::calibrate();
  if (const auto ready = prepare_ride(setting); !ready) return ready.error();
  auto safe_law = ride_safe_law(setting.robot);
  if (!safe_law) return safe_law.error();
  std::string arena_text = "no arena was handed over";
  if (arena_fd >= 0 && arena::is_memory(arena_fd)) {
    auto arena = arena::Arena::attach_exec(arena_fd);
    arena_text = arena ? "" : arena.message();
    if (arena) setting.arena = std::make_unique<load::ArenaStore>(std::move(*arena));
    close(arena_fd);  // it could be written through; the mapping stays
  }
  return Zygote(std::move(setting), std::move(arena_text), std::move(*safe_law));
}

Result<> Zygote::wall_in() {
  if (kSanitized) return done();
  const Result<> walled = allow_trials_only();
  setting_.walled = static_cast<bool>(walled);
  return walled;
}

json Zygote::answer(const std::string& line, bool& quit) {
  const json request = json::parse(line, nullptr, false);
  const std::string verb = request.is_object() ? text(request, "verb") : "";
  json reply;
  if (verb == "try") {
    reply = attempt(request);
  } else if (verb == "ping") {
    reply = ping();
  } else if (verb == "quit") {
    quit = true;
    reply = {{"ok", true}};
  } else {
    reply = refuse("request", "one JSON object per line, with \"id\" and \"verb\": try, ping or quit");
  }
  if (request.is_object() && request.contains("id")) reply["id"] = request["id"];
  return reply;
}

json Zygote::ping() const {
  return {{"ok", true},
          {"robot", setting_.robot.name},
          {"joints", setting_.joints()},
          {"arena", arena_text_.empty()},
          {"arena_text", arena_text_},
          {"safe_law_text", safe_law_text_}};
}

Outcome Zygote::run(const Order& order, const Limits& limits) const {
  return run_sandboxed([&](int pipe_fd) { return stand_trial(setting_, order, limits, pipe_fd); }, limits,
                       sizeof(Report));
}

json Zygote::attempt(const json& request) {
  Order order;
  if (const std::string wrong = read_order(request, setting_, order); !wrong.empty()) return refuse("request", wrong);
  Limits limits;
  // What the robot takes is not the law's; under a law the guard has more to do than at rest.
  limits.cpu_ms = order.box_ms + 2 * setting_.ride_ms;
  limits.wall_ms = 4 * limits.cpu_ms;
  Outcome outcome = run(order, limits);
  Verdict verdict = judge(outcome, limits);
  if (verdict.out_of_time) {  // time that a hypervisor takes counts as the child's: nobody is judged by one stall
    limits.cpu_ms *= 2;
    limits.wall_ms *= 2;
    outcome = run(order, limits);
    verdict = judge(outcome, limits);
  }
  json reply = {{"ok", verdict.ok},
                {"stage", "trial"},
                {"section", name_of(static_cast<Section>(verdict.report.section))},
                {"starved", verdict.starved},
                {"unavailable", verdict.unable},
                {"ms", outcome.wall_ms},
                {"cpu_ms", outcome.cpu_ms},
                {"report", to_json(verdict.report, setting_.plain.baseline, setting_.heavy.baseline, setting_.joints(),
                                   order.budget_ns)}};
  if (verdict.ok) reply["warnings"] = warnings(verdict.report, setting_);
  if (!verdict.ok) reply["reason"] = verdict.reason;
  if (verdict.pc_offset != 0) reply["pc_offset"] = verdict.pc_offset;
  return reply;
}

}  // namespace lithe::trial
