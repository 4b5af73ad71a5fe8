// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/services/trial_link.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <utility>

#include "spine/core/time.hpp"

namespace lithe::control {

namespace {

Json request_of(const TrialRequest& trial) {
  Json request = {{"verb", "try"},
                  {"robot", trial.recording},
                  {"budget_ns", trial.budget_ns},
                  {"box_ms", trial.box_ms},
                  {"params", trial.params}};
  if (trial.placed.slot == 0) {
    request["object"] = trial.object;
  } else {
    request["slot"] = trial.placed.slot;
    request["code_bytes"] = trial.placed.code_bytes;
    request["entry"] = trial.placed.entry;
    request["image_hash"] = trial.placed.image_hash;
  }
  return request;
}

Refusal refusal_of(const Json& answer) {
  const bool starved = answer.value("starved", false), unavailable = answer.value("unavailable", false);
  const std::string reason = answer.value("reason", "the trial gave no reason");
  const Json hints = answer.value("hints", Json::array());
  const std::string hint = hints.empty() ? "correct the source and swap again" : hints[0].get<std::string>();
  return {starved       ? "trial_starved"
          : unavailable ? "trial_unavailable"
                        : "trial_failed",
          fmt::format("{}: {}", answer.value("section", "?"), reason),
          starved       ? std::string("the running law is unchanged; try again when the machine is less busy")
          : unavailable ? "the running law is unchanged, and nothing is known against the new one: a trial needs "
                          "seccomp, resource limits and, with [spine] loader = arena, the arena: see docs/swap.md"
                        : "the running law is unchanged; " + hint,
          {{"stage", "trial"}, {"trial", answer}}};
}

}  // namespace

TrialLink::TrialLink(std::string program, std::string robot_file, std::vector<int> cpus)
    : ServiceLink("trial", "trial", "trial_starved",
                  {.argv = {std::move(program), std::move(robot_file)}, .cpus = std::move(cpus)}) {}

Result<> TrialLink::start(std::int64_t now_ns) {
  const auto started = ServiceLink::start(now_ns);
  if (!started || given() < 0) return started;
  const auto take = [](const Answer& answer) {
    const Json* json = std::get_if<Json>(&answer);
    if (json != nullptr && !json->value("arena", false)) {
      spdlog::error("the trial cannot have the arena ({}): every placed law will be refused as trial_unavailable",
                    json->value("arena_text", ""));
    }
  };
  ask({{"verb", "ping"}}, Turn::next, 10 * kNsPerS, take, now_ns);
  return started;
}

void TrialLink::ask_safe_law(Callback callback, std::int64_t limit_ns, std::int64_t now_ns) {
  ask({{"verb", "ping"}}, Turn::next, limit_ns, std::move(callback), now_ns);
}

void TrialLink::attempt(const TrialRequest& trial, Callback callback, std::int64_t now_ns, Turn turn, int starved) {
  const std::int64_t limit_ns = 4 * trial.box_ms * kNsPerMs + 10 * kNsPerS;
  const int most = turn == Turn::idle ? 1 : kMostStarved;
  const auto take = [this, trial, turn, starved, most, callback = std::move(callback)](const Answer& answer) {
    const Json* json = std::get_if<Json>(&answer);
    if (json == nullptr || json->value("ok", false))
      callback(answer);
    else if (json->value("starved", false) && starved + 1 < most)
      attempt(trial, callback, monotonic_ns(), turn, starved + 1);
    else
      callback(refusal_of(*json));
  };
  ask(request_of(trial), turn, limit_ns, take, now_ns);
}

}  // namespace lithe::control
