// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/core/talk.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <iostream>
#include <set>
#include <vector>

#include "spine/core/host/paths.hpp"
#include "spine/core/text.hpp"
#include "supervisor/link/client/presence.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::cli {
namespace {

// ASCII only: control characters are escaped, so that a terminal does not act on them.
void print_json(const Json& json) { std::cout << json.dump(2, ' ', true, Json::error_handler_t::replace) << std::endl; }

}  // namespace

int exit_code(const Refusal& refusal) {
  static const std::set<std::string> usage = {"usage",          "bad_request", "bad_config", "unknown_verb",
                                              "several_robots", "no_source",   "no_python"};
  static const std::set<std::string> fault = {"robot_fault", "refused_fault", "refused_damaged", "internal",
                                              "recover_failed"};
  return usage.count(refusal.code) != 0 ? 2 : fault.count(refusal.code) != 0 ? 3 : 1;
}

namespace {

// The robot to use: one with a supervisor if there is one, else one whose Spine ticks without.
std::variant<std::string, Refusal> find_robot() {
  std::vector<std::string> running = control::running_robots();
  for (const std::string& robot : running.empty() ? control::robots_with_memory() : std::set<std::string>{})
    if (control::spine_now(robot)) running.push_back(robot);
  if (running.empty()) {
    return Refusal{"no_robot", fmt::format("no robot is running here (looked in {})", run_dir()),
                   "start one: lithe run robots/arm.toml"};
  }
  if (running.size() > 1) {
    return Refusal{"several_robots", fmt::format("several robots are running: {}", fmt::join(running, ", ")),
                   "say which: --robot NAME"};
  }
  return running.front();
}

}  // namespace

std::string which_robot(const Context& context) {
  return context.robot.empty() ? value_of(find_robot()) : context.robot;
}

std::variant<control::Client, Refusal> connect(const Context& context) {
  const auto robot = context.robot.empty() ? find_robot() : context.robot;
  if (const auto* refusal = std::get_if<Refusal>(&robot)) return *refusal;
  return control::reach(std::get<std::string>(robot));
}

Answer try_ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms) {
  auto client = connect(context);
  if (const auto* refusal = std::get_if<Refusal>(&client)) return *refusal;
  return std::get<control::Client>(client).call(verb, args, timeout_ms);
}

Json ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms) {
  return value_of(try_ask(context, verb, args, timeout_ms));
}

int refuse(const Context& context, const Refusal& refusal) {
  if (context.json) {
    print_json({{"ok", false}, {"error", refusal.to_json()}});
  } else {
    std::cerr << printable(refusal.message, true) << '\n';
    if (refusal.detail.is_object()) {
      const std::string text = refusal.detail.value("text", "");
      if (!text.empty() && text != refusal.message)
        std::cerr << printable(text, true) << (text.back() == '\n' ? "" : "\n");
    }
    if (!refusal.next.empty()) std::cerr << "next: " << printable(refusal.next, true) << '\n';
  }
  return exit_code(refusal);
}

int finish(const Context& context, const Json& result, const std::function<void(const Json&)>& print) {
  if (context.json) {
    print_json(result);
  } else {
    print(control::printable_json(result));
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace lithe::cli
