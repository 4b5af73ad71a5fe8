// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/services/trial_link.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <utility>

#include "spine/core/time.hpp"

namespace lithe::control {

using swap::Answer;
using swap::Json;
using swap::Refusal;

namespace {

Launch launch_of(std::string program, std::string robot_file, std::vector<int> cpus) {
  Launch launch;
  launch.argv = {std::move(program), std::move(robot_file)};
  launch.cpus = std::move(cpus);
  return launch;
}

Json request_of(const TrialRequest& trial) {
  Json request = {{"verb", "try"},
                  {"robot", trial.recording},
                  {"budget_ns", trial.budget_ns},
                  {"box_ms", trial.box_ms},
                  {"params", trial.params}};
  if (trial.slot == 0) {
    request["object"] = trial.object;
  } else {
    request["slot"] = trial.slot;
    request["code_bytes"] = trial.code_bytes;
    request["entry"] = trial.entry;
    request["image_hash"] = trial.image_hash;
  }
  return request;
}

Refusal refusal_of(const Json& answer) {
  const bool starved = answer.value("starved", false), unavailable = answer.value("unavailable", false);
  const std::string reason = answer.value("reason", "the trial gave no reason");
  return {starved       ? "trial_starved"
          : unavailable ? "trial_unavailable"
                        : "trial_failed",
          fmt::format("{}: {}", answer.value("section", "?"), reason),
          starved ? "the running law is unchanged; try again when the machine is less busy"
          : unavailable
              ? "the running law is unchanged, and nothing is known against the new one: a trial needs seccomp, "
                "resource limits and, with [spine] loader = arena, the arena: see docs/swap.md"
              : "the running law is unchanged; correct the source and swap again",
          {{"stage", "trial"}, {"trial", answer}}};
}

}  // namespace

TrialLink::TrialLink(std::string program, std::string robot_file, std::vector<int> cpus)
    : service_("trial", "trial", "trial_starved",
               launch_of(std::move(program), std::move(robot_file), std::move(cpus))) {}

Result<> TrialLink::start(std::int64_t now_ns) {
  const auto started = service_.start(now_ns);
  if (!started || !arena_) {
    return started;
  }
  service_.ask(
      {{"verb", "ping"}}, ServiceLink::Turn::next, 10 * kNsPerS,
      [](const Answer& answer) {
        const Json* json = std::get_if<Json>(&answer);
        if (json != nullptr && !json->value("arena", false)) {
          spdlog::error("the trial cannot have the arena ({}): every placed law will be refused as trial_unavailable",
                        json->value("arena_text", ""));
        }
      },
      now_ns);
  return started;
}

void TrialLink::ask_safe_law(SafeLawTold told, std::int64_t now_ns) {
  service_.ask(
      {{"verb", "ping"}}, ServiceLink::Turn::next, kSafeLawNs,
      [told = std::move(told)](const Answer& answer) {
        if (const Json* json = std::get_if<Json>(&answer)) {
          told(json->value("safe_law_text", ""), "");
        } else {
          told(std::nullopt, std::get<Refusal>(answer).message);
        }
      },
      now_ns);
}

void TrialLink::attempt(const TrialRequest& trial, Callback callback, std::int64_t now_ns) {
  ask(trial, 0, std::move(callback), now_ns);
}

void TrialLink::ask(const TrialRequest& trial, int starved, Callback callback, std::int64_t now_ns) {
  const std::int64_t limit_ns = 4 * trial.box_ms * kNsPerMs + 10 * kNsPerS;
  service_.ask(
      request_of(trial), ServiceLink::Turn::in_line, limit_ns,
      [this, trial, starved, callback = std::move(callback)](const Answer& answer) {
        const Json* json = std::get_if<Json>(&answer);
        if (json == nullptr || json->value("ok", false)) {
          callback(answer);
        } else if (json->value("starved", false) && starved + 1 < kMostStarved) {
          ask(trial, starved + 1, callback, monotonic_ns());
        } else {
          callback(refusal_of(*json));
        }
      },
      now_ns);
}

}  // namespace lithe::control
