// SPDX-License-Identifier: Apache-2.0
#include "trial/zygote.hpp"

#include <unistd.h>

#include <algorithm>
#include <utility>

#include "spine/arena/arena.hpp"
#include "spine/core/lookup.hpp"
#include "spine/robot/robot.hpp"
#include "trial/sections/sections.hpp"
#include "trial/simulation/simulated_run.hpp"
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
  return leading_number<std::uint64_t>(digits, 16);
}

// "" or what is wrong with the request.
std::string read_request(const json& request, const TrialSetup& setup, TrialRequest& wanted) {
  const std::string object = text(request, "object");
  wanted.stage.slot = static_cast<std::uint32_t>(std::clamp<std::int64_t>(number(request, "slot", 0), 0, UINT32_MAX));
  if (object.empty() && wanted.stage.slot == 0) return "try needs \"object\", or \"slot\" and what place answered";
  if (object.size() >= wanted.stage.path.size()) return "the path of the object is too long";
  std::copy(object.begin(), object.end(), wanted.stage.path.begin());
  wanted.stage.code_bytes = static_cast<std::uint32_t>(number(request, "code_bytes", 0));
  wanted.stage.entry = word(request, "entry");
  wanted.stage.image_hash = word(request, "image_hash");
  const auto budget_ns = static_cast<double>(setup.period_ns()) * setup.robot.swap.budget_share;
  wanted.budget_ns = number(request, "budget_ns", 0);
  if (wanted.budget_ns <= 0) wanted.budget_ns = static_cast<std::int64_t>(budget_ns);
  wanted.box_ms =
      static_cast<int>(std::clamp<std::int64_t>(number(request, "box_ms", kBoxMs), kLeastBoxMs, kMostBoxMs));
  wanted.recording = text(request, "robot");
  const auto params = request.find("params");
  if (params == request.end() || params->is_null()) return "";
  if (!params->is_object()) return "\"params\" must be an object of numbers";
  for (const auto& [name, value] : params->items()) {
    if (!value.is_number()) return "\"params\" must be an object of numbers";
    wanted.params.emplace_back(name, value.get<double>());
  }
  return "";
}

}  // namespace

Result<Zygote> Zygote::make(const std::string& robot_path, int arena_fd) {
  auto robot = robot::load_robot(robot_path);
  if (!robot) return robot.error();
  TrialSetup setup;
  setup.robot = std::move(*robot);
  setup.clock = RawClock::calibrate();
  if (const auto ready = prepare_runs(setup); !ready) return ready.error();
  auto safe_law = run_safe_law(setup.robot);
  if (!safe_law) return safe_law.error();
  std::string arena_text = "no arena was handed over";
  if (arena_fd >= 0 && arena::is_memory(arena_fd)) {
    auto arena = arena::Arena::attach_exec(arena_fd);
    arena_text = arena ? "" : arena.message();
    if (arena) setup.arena = std::make_unique<load::ArenaStore>(std::move(*arena));
    close(arena_fd);  // it could be written through; the mapping stays
  }
  return Zygote(std::move(setup), std::move(arena_text), std::move(*safe_law));
}

Result<> Zygote::install_filter() {
  if (kSanitized) return done();
  const Result<> filtered = allow_trials_only();
  setup_.filtered = static_cast<bool>(filtered);
  return filtered;
}

json Zygote::answer(const std::string& line, bool& quit) {
  const json request = json::parse(line, nullptr, false);
  const std::string verb = request.is_object() ? text(request, "verb") : "";
  quit = verb == "quit";
  json reply = refuse("request", "one JSON object per line, with \"id\" and \"verb\": try, ping or quit");
  if (verb == "try") reply = attempt(request);
  if (verb == "ping") reply = ping();
  if (quit) reply = {{"ok", true}};
  if (request.is_object() && request.contains("id")) reply["id"] = request["id"];
  return reply;
}

json Zygote::ping() const {
  return {{"ok", true},
          {"robot", setup_.robot.name},
          {"joints", setup_.joints()},
          {"arena", arena_text_.empty()},
          {"arena_text", arena_text_},
          {"safe_law_text", safe_law_text_}};
}

json Zygote::attempt(const json& request) {
  TrialRequest wanted;
  if (const std::string wrong = read_request(request, setup_, wanted); !wrong.empty()) return refuse("request", wrong);
  Limits limits;
  // What the robot takes is not the law's; under a law the guard has more to do than at rest.
  limits.cpu_ms = wanted.box_ms + 2 * setup_.run_ms;
  limits.wall_ms = 4 * limits.cpu_ms;
  const auto run = [&] {
    return run_sandboxed([&](int fd) { return run_trial(setup_, wanted, limits, fd); }, limits, sizeof(Report));
  };
  Outcome outcome = run();
  Verdict verdict = verdict_of(outcome, limits);
  if (verdict.out_of_time) {  // time that a hypervisor takes counts as the child's: no_torque is judged by one stall
    limits.cpu_ms *= 2;
    limits.wall_ms *= 2;
    outcome = run();
    verdict = verdict_of(outcome, limits);
  }
  json reply = {{"ok", verdict.ok},
                {"stage", "trial"},
                {"section", name_of(static_cast<Section>(verdict.report.section))},
                {"starved", verdict.starved},
                {"unavailable", verdict.unable},
                {"ms", outcome.wall_ms},
                {"cpu_ms", outcome.cpu_ms},
                {"report", to_json(verdict.report, setup_.plain.baseline, setup_.heavy.baseline, setup_.joints(),
                                   wanted.budget_ns)}};
  if (verdict.ok) reply["warnings"] = warnings(verdict.report, setup_);
  if (!verdict.starved && !verdict.unable) reply["hints"] = hints(verdict.report, setup_, verdict.ok);
  if (!verdict.ok) reply["reason"] = verdict.reason;
  if (verdict.pc_offset != 0) reply["pc_offset"] = verdict.pc_offset;
  return reply;
}

}  // namespace lithe::trial
