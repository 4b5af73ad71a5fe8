// SPDX-License-Identifier: Apache-2.0
// `lithe list`: the robots of this machine, also those whose Spine ticks without a supervisor.
#include <fmt/format.h>

#include <filesystem>
#include <set>
#include <string>
#include <system_error>

#include "spine/core/host/paths.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/talk.hpp"
#include "supervisor/link/client/presence.hpp"

namespace lithe::cli {
namespace {

std::set<std::string> known_robots() {
  std::set<std::string> names = control::robots_with_memory();
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(run_dir(), ignored))
    if (entry.path().extension() == ".sock" || entry.path().extension() == ".pid") names.insert(entry.path().stem());
  return names;
}

std::string with_pid(const Json& pid, const std::string& what) {
  return pid.is_number() && pid > 0 ? fmt::format("pid {} {}", pid.get<int>(), what) : what;
}

void print_list(const Json& list) {
  if (list["robots"].empty()) {
    fmt::print("no robot runs here (looked in {}); start one: lithe run robots/arm.toml\n", run_dir());
    return;
  }
  fmt::print("{:<14} {:<10} {:<16} {:>10}  {:<24} {}\n", "robot", "mode", "law", "tick", "supervisor", "Spine");
  for (const Json& each : list["robots"]) {
    const std::string spine = each["spine_pid"].is_null()
                                  ? "none"
                                  : with_pid(each["spine_pid"], each["ticks"].is_null() ? "cannot be read"
                                                                : each["ticks"] == true ? "ticks"
                                                                                        : "does not tick");
    fmt::print("{:<14} {:<10} {:<16} {:>10}  {:<24} {}\n", each["robot"].get<std::string>(),
               each["mode"].get<std::string>(), each["law"].get<std::string>(), each["tick"].get<std::uint64_t>(),
               with_pid(each["supervisor_pid"], each["supervisor"].get<std::string>()), spine);
  }
}

}  // namespace

int list(const Context& context) {
  Json robots = Json::array();
  for (const std::string& name : known_robots()) {
    if (!context.robot.empty() && name != context.robot) continue;
    const control::Presence there = control::look_for(name);
    if (there.is_there()) robots.push_back(control::presence_json(there));
  }
  return finish(context, Json{{"robots", robots}}, print_list);
}

}  // namespace lithe::cli
