// SPDX-License-Identifier: Apache-2.0
// After start-up: loads the first law, and arms.
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/time.hpp"
#include "supervisor/run/supervisor.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kArmTimeoutNs = 5 * kNsPerS;
constexpr int kTries = 5;  // of which each trial is several; a machine that boots is busy

std::int64_t arm_timeout_ns(const robot::RobotConfig& robot) {
  std::int64_t longest_ns = kArmTimeoutNs;
  for (const robot::DeviceConfig& device : robot.devices)
    longest_ns = std::max<std::int64_t>(longest_ns, std::llround(1e9 * robot::facts(device.kind).arm_timeout_s));
  return longest_ns;
}

std::string words_of(const Refusal& refusal) {
  std::string words = refusal.message;
  if (refusal.detail.is_object() && !refusal.detail.value("text", "").empty())
    words += "\n" + refusal.detail["text"].get<std::string>();
  return words;
}

}  // namespace

// Refuses the start when the law was refused, or nothing was answered.
void Supervisor::must_run(const std::optional<Answer>& answer, const char* silence) const {
  if (!answer) throw Halt{1, silence};
  if (const auto* refusal = std::get_if<Refusal>(&*answer))
    throw Halt{1, fmt::format("the law {} cannot run: {}", first_law_, words_of(*refusal))};
}

std::optional<Answer> Supervisor::patient_answer_to(const Ask& ask, std::int64_t timeout_ns) {
  for (int tries = 1;; ++tries) {
    auto answer = answer_to(ask, timeout_ns);
    const auto* refusal = answer ? std::get_if<Refusal>(&*answer) : nullptr;
    if (refusal == nullptr || !refusal->code.ends_with("_starved") || tries == kTries) return answer;
    spdlog::warn("once more ({} of {}): {}", tries + 1, kTries, refusal->message);
  }
}

void Supervisor::compile_first_law() {
  first_law_ = options_.law.empty() ? config_.law : options_.law;
  if (first_law_.empty()) return;
  auto source = read_regular_file(first_law_, kMaxLawBytes);
  if (const fs::path known = fs::path(options_.laws) / fs::path(first_law_).filename();
      options_.law.empty() && !fs::exists(first_law_) && fs::exists(known)) {
    spdlog::warn("there is no {}: {} is taken", first_law_, known.string());
    first_law_ = known.string();
    source = read_regular_file(first_law_, kMaxLawBytes);
  }
  if (!source || source->empty()) {
    throw Halt{2, fmt::format("cannot read the law {}; give another with --law FILE",
                              source ? first_law_ + ": it is empty" : source.message())};
  }
  first_source_ = std::move(*source);
  spdlog::info("compiling {}", first_law_);
  const LawText law{fs::path(first_law_).filename().string(), first_source_};
  must_run(patient_answer_to([&](const auto& take) { lawd_.compile(law, take, monotonic_ns()); },
                             lawd_.limit_ns() + kNsPerS),
           "the compile service does not answer");
}

// The trial simulates it while the first law is compiled. With open gates nobody does.
void Supervisor::try_safe_law() {
  if (!options_.gates) return;
  const auto answer =
      patient_answer_to([this](const auto& take) { trial_.ask_safe_law(take, lawd_.limit_ns(), monotonic_ns()); },
                        lawd_.limit_ns() + kNsPerS);
  const Json* told = answer ? std::get_if<Json>(&*answer) : nullptr;
  if (told == nullptr) {
    throw Halt{1, fmt::format("the trial could not run the safe law: {}",
                              answer ? std::get<Refusal>(*answer).message : "it does not answer")};
  }
  if (const std::string wrong = told->value("safe_law_text", ""); !wrong.empty())
    throw Halt{2, fmt::format("{}: {}", options_.config_path, wrong)};
}

void Supervisor::swap_first_law() {
  if (first_source_.empty()) return;
  SwapRequest request{fs::path(first_law_).filename().string(), first_source_};
  request.terms = std::get<SwapTerms>(swaps_->read_terms(Json::object()));
  must_run(
      patient_answer_to([&](const auto& take) { swaps_->submit(request, take, monotonic_ns()); }, 4 * lawd_.limit_ns()),
      "the first law was not committed");
}

void Supervisor::swap_adopted_law() {
  if (options_.law.empty()) return;
  try {
    compile_first_law();
    swap_first_law();
  } catch (const Halt& halt) {
    if (stop_asked_ || halt.code == 3) throw;
    spdlog::error("{}; the adopted robot keeps the law it has", halt.message);
  }
}

void Supervisor::arm() {
  if (!options_.arm) return;
  if (first_source_.empty())
    return spdlog::warn("not armed: {} names no law; swap one in, then: lithe arm", options_.config_path);
  const std::int64_t brain_age_ns = link_->now().brain_age_ns;
  const bool no_brain = brain_age_ns < 0 || brain_age_ns > std::llround(1e9 * config_.brain.stale_after_s);
  if (no_brain && config_.brain.on_stale == robot::StaleAction::safe_stop) {
    return spdlog::warn(
        "not armed: it may move only while a Brain lives ([brain] on_stale = \"safe_stop\"); from there: robot.arm()");
  }
  const std::int64_t deadline_ns = monotonic_ns() + arm_timeout_ns(config_);
  std::string why = "its Spine does not answer";
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(wire::CommandKind::arm);
  do {
    const auto answer =
        answer_to([&](const auto& take) { commands_->send(command, take, monotonic_ns()); }, kArmTimeoutNs);
    const auto* refusal = answer ? std::get_if<Refusal>(&*answer) : nullptr;
    if (answer && refusal == nullptr) return;
    if (refusal != nullptr && refusal->code == "refused_outside")  // `recover` needs a running robot
      return spdlog::warn("not armed: {}; {}", refusal->message, refusal->next);
    if (refusal != nullptr) why = fmt::format("{}; {}", refusal->message, refusal->next);
    // Drives come up one after the other, and may clear their faults by themselves.
    const bool waits = static_cast<wire::Mode>(link_->now().mode) == wire::Mode::disarmed;
    if (refusal != nullptr && !(waits && (refusal->code == "refused_not_ready" || refusal->code == "refused_fault")))
      break;
    turn(10);
  } while (monotonic_ns() < deadline_ns);
  throw Halt{3, fmt::format("the robot cannot be armed: {}. To have it run without torque: lithe run --no-arm", why)};
}

}  // namespace lithe::control
