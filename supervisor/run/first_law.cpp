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

std::int64_t arm_timeout_ns(const robot::RobotConfig& robot) {
  std::int64_t longest_ns = kArmTimeoutNs;
  for (const robot::DeviceConfig& device : robot.devices) {
    longest_ns = std::max<std::int64_t>(longest_ns, std::llround(1e9 * robot::facts(device.kind).arm_timeout_s));
  }
  return longest_ns;
}

std::string words_of(const Refusal& refusal) {
  std::string words = refusal.message;
  if (refusal.detail.is_object() && !refusal.detail.value("text", "").empty()) {
    words += "\n" + refusal.detail["text"].get<std::string>();
  }
  return words;
}

}  // namespace

void Supervisor::compile_first_law() {
  const std::string path = options_.law.empty() ? config_.law : options_.law;
  if (path.empty()) {
    return;
  }
  auto source = read_regular_file(path, kMaxLawBytes);
  if (!source || source->empty()) {
    throw Halt{1, fmt::format("cannot read the law {}; give another with --law FILE",
                              source ? path + ": it is empty" : source.message())};
  }
  first_source_ = std::move(*source);
  spdlog::info("compiling {}", path);
  std::optional<Answer> answer;
  lawd_.compile(
      {fs::path(path).filename().string(), first_source_}, [&answer](const Answer& got) { answer = got; },
      monotonic_ns());
  turn_until([&answer] { return answer.has_value(); }, LawdLink::kCompileTimeoutNs + kNsPerS);
  if (!answer) {
    throw Halt{1, "the compile service does not answer"};
  }
  if (const auto* refusal = std::get_if<Refusal>(&*answer)) {
    throw Halt{1, fmt::format("the law {} cannot run: {}", path, words_of(*refusal))};
  }
}

// The trial rides it while the first law is compiled. Without the gates nobody does.
void Supervisor::try_safe_law() {
  if (!options_.gates) {
    return;
  }
  bool answered = false;
  std::optional<std::string> wrong;
  std::string why = "it does not answer";
  trial_.ask_safe_law(
      [&](const std::optional<std::string>& text, const std::string& silent) {
        answered = true;
        wrong = text;
        why = silent;
      },
      monotonic_ns());
  turn_until([&answered] { return answered; }, TrialLink::kSafeLawNs + kNsPerS);
  if (!wrong) {
    throw Halt{1, fmt::format("the trial could not ride the safe law: {}", why)};
  }
  if (!wrong->empty()) {
    throw Halt{2, fmt::format("{}: {}", options_.config_path, *wrong)};
  }
}

void Supervisor::swap_first_law() {
  if (first_source_.empty()) {
    return;
  }
  const std::string path = options_.law.empty() ? config_.law : options_.law;
  std::optional<Answer> answer;
  swaps_->submit(
      {fs::path(path).filename().string(), first_source_, Json::object(),
       std::get<swap::Terms>(swaps_->read_terms(Json::object()))},
      [&answer](const Answer& got) { answer = got; }, monotonic_ns());
  turn_until([&answer] { return answer.has_value(); }, 4 * LawdLink::kCompileTimeoutNs);
  if (!answer) {
    throw Halt{1, "the first law was not committed"};
  }
  if (const auto* refusal = std::get_if<Refusal>(&*answer)) {
    throw Halt{1, fmt::format("the law {} cannot run: {}", path, words_of(*refusal))};
  }
}

void Supervisor::swap_adopted_law() {
  if (options_.law.empty()) {
    return;
  }
  try {
    compile_first_law();
    swap_first_law();
  } catch (const Halt& halt) {
    if (stop_asked_ || halt.code == 3) {
      throw;
    }
    spdlog::error("{}; the adopted robot keeps the law it has", halt.message);
  }
}

void Supervisor::arm() {
  if (!options_.arm) {
    return;
  }
  if (first_source_.empty()) {
    spdlog::warn("not armed: {} names no law; swap one in, then: lithe arm", options_.config_path);
    return;
  }
  const std::int64_t deadline_ns = monotonic_ns() + arm_timeout_ns(config_);
  std::optional<Answer> answer;
  do {
    answer.reset();
    wire::Command command;
    command.kind = static_cast<std::uint32_t>(wire::CommandKind::arm);
    commands_->send(command, [&answer](const Answer& got) { answer = got; }, monotonic_ns());
    turn_until([&answer] { return answer.has_value(); }, kArmTimeoutNs);
    const auto* refusal = answer ? std::get_if<Refusal>(&*answer) : nullptr;
    if (answer && refusal == nullptr) {
      return;
    }
    if (refusal != nullptr && refusal->code == "refused_outside") {  // `recover` needs a running robot
      spdlog::warn("not armed: {}; {}", refusal->message, refusal->next);
      return;
    }
    if (refusal != nullptr && refusal->code != "refused_not_ready") {
      throw Halt{3, fmt::format("the robot cannot be armed: {}; {}", refusal->message, refusal->next)};
    }
    turn(10);
  } while (monotonic_ns() < deadline_ns);
  throw Halt{3,
             "the robot cannot be armed: not every drive answers or is set up as it must be; what is wrong with which "
             "stands above, or check power, bus and ids in the robot file"};
}

}  // namespace lithe::control
