// SPDX-License-Identifier: Apache-2.0
// `lithe incident list`, `show` and `plot`: from the files, so no robot needs to run.
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <variant>
#include <vector>

#include "supervisor/cli/core/act.hpp"
#include "supervisor/incident/incidents.hpp"

namespace lithe::cli {
namespace {

namespace fs = std::filesystem;

// The folder of the command line, else that of the running robot, else of the robot named.
fs::path incidents_folder(const Context& context, const std::string& folder) {
  if (!folder.empty()) return folder;
  Answer answer = try_ask(context, "status", Json::object());
  if (const Json* status = std::get_if<Json>(&answer); status != nullptr && status->contains("incidents"))
    return fs::path((*status)["incidents"]["folder"].get<std::string>());
  if (!context.robot.empty()) return control::incidents_of(context.robot);
  if (auto* refusal = std::get_if<Refusal>(&answer)) {
    refusal->next = "say which robot: --robot NAME; or where: --folder DIR";
    throw std::move(*refusal);
  }
  throw Refusal{"no_incidents", "the robot that runs keeps no incidents", "start it again with this build"};
}

std::vector<Json> all_incidents(const fs::path& folder) {
  std::vector<Json> found = control::read_incidents(folder);
  if (found.empty()) {
    std::error_code failure;
    throw Refusal{"no_incidents",
                  fmt::format("there {} {}", fs::is_directory(folder, failure) ? "are no incidents in" : "is no folder",
                              folder.string()),
                  "each fault, rollback, refusal in the tick and change of mode leaves one"};
  }
  return found;
}

std::string shown(const Json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (value.is_null()) return "none";
  if (value.is_number_float()) return fmt::format("{:.4g}", value.get<double>());
  if (value.contains("name")) return fmt::format("{} (id {})", shown(value["name"]), value.value("law_id", 0u));
  if (value.contains("before") && value.contains("after")) {
    const std::string before = shown(value["before"]), after = shown(value["after"]);
    return before == after ? before : before + " -> " + after;
  }
  if (value.is_array() && value.size() == 2) return fmt::format("{} to {}", shown(value[0]), shown(value[1]));
  return control::dump_line(value);
}

std::string text_at(const Json& from, const char* key) {
  const auto found = from.find(key);
  return found == from.end() ? "-" : shown(*found);
}

void print_incidents(const Json& result) {
  for (const Json& each : result["incidents"])
    fmt::print("{:>5}  {}  {}\n", text_at(each, "id"), text_at(each, "time"), text_at(each, "what"));
}

void print_incident(const Json& incident) {
  fmt::print("{}  {}\n  {}\n", text_at(incident, "id"), text_at(incident, "time"), text_at(incident, "what"));
  fmt::print("  mode {}, law {}, {} ticks, lost {}\n", text_at(incident, "mode"), text_at(incident, "law"),
             text_at(incident, "ticks"), text_at(incident, "ticks_lost"));
  for (const Json& joint : incident.value("joints", Json::array())) {
    fmt::print("  {:<12} {} rad, {} rad/s, {} N m, error {} rad at most\n", text_at(joint, "name"),
               text_at(joint, "position_rad"), text_at(joint, "velocity_rad_s"), text_at(joint, "command_torque_nm"),
               text_at(joint, "largest_error_rad"));
  }
  for (const Json& event : incident.value("events", Json::array()))
    fmt::print("  tick {:<8} {} {}\n", text_at(event, "tick"), text_at(event, "kind"), text_at(event, "text"));
  fmt::print("telemetry: {}; a picture of it: lithe incident plot {}\n", text_at(incident, "path"),
             text_at(incident, "id"));
}

// Its summary, with "path", where its telemetry is.
Json find_incident(const Context& context, const std::string& which, const std::string& folder_word) {
  const fs::path folder = incidents_folder(context, folder_word);
  const std::vector<Json> all = all_incidents(folder);
  const auto found = which == "last"
                         ? all.end() - 1
                         : std::ranges::find_if(all, [&](const Json& each) { return text_at(each, "id") == which; });
  if (found == all.end()) {
    throw Refusal{"no_incident", fmt::format("there is no incident '{}' in {}", which, folder.string()),
                  "say last, or a number of lithe incident list"};
  }
  Json incident = *found;
  incident["path"] = (folder / incident.value("data", "")).string();
  return incident;
}

}  // namespace

int incident_list(const Context& context, const std::string& folder_word) {
  const fs::path folder = incidents_folder(context, folder_word);
  return finish(context, Json{{"folder", folder.string()}, {"incidents", all_incidents(folder)}}, print_incidents);
}

int incident_show(const Context& context, const std::string& which, const std::string& folder) {
  return finish(context, find_incident(context, which, folder), print_incident);
}

int incident_plot(const Context& context, const std::string& which, const std::string& folder, const std::string& out) {
  std::vector<std::string> words{text_at(find_incident(context, which, folder), "path")};
  if (!out.empty()) words.insert(words.end(), {"--out", out});
  run_module("lithe.incident", words);
}

}  // namespace lithe::cli
