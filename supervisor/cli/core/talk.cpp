// SPDX-License-Identifier: Apache-2.0
#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <iostream>
#include <set>
#include <vector>

#include "spine/core/host/child.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/link/client/client.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::cli {
namespace {

// ASCII only: control characters are escaped, so that a terminal does not act on them.
void print_json(const Json& json) { std::cout << json.dump(2, ' ', true, Json::error_handler_t::replace) << std::endl; }

}  // namespace

int exit_code(const Refusal& refusal) {
  static const std::set<std::string> usage = {"usage",          "bad_request", "bad_config", "unknown_verb",
                                              "several_robots", "no_source",   "no_python",  "no_tune"};
  static const std::set<std::string> fault = {"robot_fault", "refused_fault", "refused_damaged", "internal",
                                              "recover_failed"};
  return usage.count(refusal.code) != 0 ? 2 : fault.count(refusal.code) != 0 ? 3 : 1;
}

namespace {

// The robot to use: one with a supervisor if there is one, else one whose Spine ticks without, or that is starting.
std::variant<std::string, Refusal> find_robot() {
  std::vector<std::string> running = control::running_robots();
  for (const std::string& robot : running.empty() ? control::known_robots() : std::set<std::string>{})
    if (control::spine_now(robot) || control::look_for(robot).supervisor != control::Presence::Supervisor::none)
      running.push_back(robot);
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

namespace {

std::string plain(const Json& value) { return value.is_string() ? value.get<std::string>() : value.dump(); }

std::string lines_from(const Json& from, const char* key, const char* indent, const char* what) {
  std::string lines;
  const Json all = from.value(key, Json::array());
  for (const Json& each : all) lines += fmt::format("{}{}: {}\n", indent, what, plain(each));
  return lines;
}

}  // namespace

double number(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<double>() : 0.0;
}

std::string word(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "-";
}

std::string listed(const Json& words) { return joined(words, plain); }

std::string warning_lines(const Json& from, const char* indent) {
  return lines_from(from, "warnings", indent, "warning") + lines_from(from, "hints", indent, "hint");
}

std::string cleaned_lines(const Json& from) { return lines_from(from, "cleaned", "", "cleaned"); }

void print_command(const std::string& verb, const Json& result) {
  fmt::print("{}: mode {} at tick {}{}\n", verb, word(result, "mode"), result.value("tick", std::uint64_t{0}),
             result.contains("law")    ? fmt::format(", law {}", word(result, "law"))
             : result.contains("what") ? ": " + word(result, "what")
                                       : "");
}

// `lithe agent`, `mcp`, `evolve`, `identify`, `incident plot`: modules of the Python package; `lithe sim`: lithe-sim.

namespace {

// Whether this interpreter is there and has the package.
bool has_package(const std::string& python) {
  constexpr const char* kLook = "import importlib.util as u; raise SystemExit(u.find_spec('lithe') is None)";
  const auto look = [&python](int) {
    const int null = ::open("/dev/null", O_RDWR);
    for (const int fd : {0, 1, 2}) ::dup2(null, fd);
    return exec_program({python, "-c", kLook});
  };
  const ChildEnd end = run_forked(look, {.wall_ms = 60'000, .output_bytes = 0});
  return end.started && end.signal == 0 && end.exit_code == 0;
}

}  // namespace

[[noreturn]] void run_module(const std::string& module, const std::vector<std::string>& words) {
  const std::string venv = std::filesystem::path(program_dir() + "/../../../.venv").lexically_normal();
  for (const std::string& python : {venv + "/bin/python", std::string("python3")}) {
    if (!has_package(python)) continue;
    std::vector<std::string> all{python, "-m", module};
    all.insert(all.end(), words.begin(), words.end());
    (void)exec_program(all);
  }
  throw Refusal{"no_python", module + " needs a Python with the package lithe: neither " + venv + " nor python3 has it",
                "make it: tools/setup; or activate the environment that has it"};
}

[[noreturn]] void simulate(const std::vector<std::string>& words) {
  const std::string program = program_dir() + "/lithe-sim";
  std::vector<std::string> argv = words;
  argv.insert(argv.begin(), program);
  const int why = exec_program(argv);
  throw Refusal{"no_program", "cannot start " + program + ": " + std::strerror(why), "build it: make release"};
}

}  // namespace lithe::cli
