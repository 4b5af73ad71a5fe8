// SPDX-License-Identifier: Apache-2.0
// One function per command. Each prints its own result and returns the exit code 0, or throws a Refusal, which main()
// prints: 1 refused, 2 usage, 3 robot fault.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "supervisor/bus/monitor/monitor.hpp"
#include "supervisor/bus/plan/plan.hpp"
#include "supervisor/bus/scan/place.hpp"
#include "supervisor/bus/scan/scan.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/link/client/client.hpp"

namespace lithe::cli {

struct Context {
  bool json = false;
  std::string robot;          // empty: the only one that runs
  std::string units = "deg";  // of angles shown to a person: deg or rad
};

// A move of one joint, which ends at rest.
struct Motion {
  std::string joint;
  double angle_deg = 0;
  bool relative = false;  // relative to the setpoint
  double in_s = 2.0;
};

struct DoctorOptions {
  std::optional<int> cpu;  // nothing: the core that the Spine would get
  double measure_s = 0;    // 0: no measurement
  bool all = false;        // also what is in order
};

// `lithe tune`.
struct TuneWords {
  std::string root;                  // empty: this machine
  std::string cores;                 // "1,3"; empty: those that lithe run would take
  std::string robot;                 // a robot file, for its cores and devices; empty: any robot
  bool partition = false;            // with an isolated partition of cgroup v2
  bool no_files = false;             // of plan and apply: only what ends with this boot
  bool force = false;                // of revert
  std::vector<std::string> command;  // of shield
};

int exit_code(const control::Refusal& refusal);

// The laws that come with LITHE: installed beside the program, else the source tree it was built from.
std::filesystem::path laws_dir();

// The robots of this machine, also those whose Spine ticks without a supervisor.
int list(const Context& context);
int status(const Context& context);
// Acts as the robot's Brain during the move.
int move(const Context& context, const Motion& motion);
// arm, disarm, hold, reset, sim_reset, shutdown
int command(const Context& context, const std::string& verb, const control::Json& args = control::Json::object());
int estop(const Context& context);
// Brings joints inside their limits and waits until they are, or until the Spine says why not.
int recover(const Context& context);
int rollback(const Context& context, int steps);
int law_activate(const Context& context, const std::string& law);
// `terms`: arguments of the verb swap that are numbers (docs/reference/verbs.md). `no_promote`: its shadow is measured.
int swap_law(const Context& context, const std::string& law, const std::vector<std::string>& params,
             const std::map<std::string, double>& terms, bool no_promote);
int law_check(const Context& context, const std::string& law);
int law_list(const Context& context);
// Certificates; `folder`: where, or empty: those of the robot the context means, running or not.
// `source`: the text of its law instead.
int law_show(const Context& context, const std::string& which, const std::string& folder, bool source);
int law_verify(const Context& context, const std::string& folder);
int param_get(const Context& context, const std::string& name);
int param_set(const Context& context, const std::vector<std::string>& words);
int param_revert(const Context& context);
int param_save(const Context& context, const std::string& path);
int events(const Context& context, std::uint64_t since, bool follow);
// What the flight recorder has kept. `which`: "last", or a number. `folder`: empty = the robot's.
int incident_list(const Context& context, const std::string& folder);
int incident_show(const Context& context, const std::string& which, const std::string& folder);
// Replaces this process by `python -m lithe.incident`, which draws it; `out`: the picture, or empty.
int incident_plot(const Context& context, const std::string& which, const std::string& folder, const std::string& out);
// Replaces this process by `python -m MODULE` with these arguments, of the checkout's .venv or of the PATH; throws a
// Refusal when neither has the package.
[[noreturn]] void run_module(const std::string& module, const std::vector<std::string>& words);
int top(const Context& context, int turns);
// Replaces this process by `lithe-sim` with these arguments; throws a Refusal when it cannot.
[[noreturn]] void simulate(const std::vector<std::string>& words);
// Plans the buses of a robot file. 0 fits, 1 does not fit, 2 no robot file.
int bus_plan(const Context& context, const std::string& file, const bus::PlanOptions& options);
// Scans the buses. 0 as the file says, 1 otherwise or refused, 2 no such bus or file.
int bus_scan(const Context& context, const bus::Words& words, const bus::ScanOptions& options);
// Shows the frames of the buses until it is stopped. 0, 1 nothing was received or no such bus, 2 no such file or
// device.
int bus_monitor(const Context& context, const bus::Words& words, bus::MonitorOptions options);
// Judges this machine. 0 tier A or B, 1 below, 2 the core cannot be judged or measured.
int doctor(const Context& context, const DoctorOptions& options);
// The machine's settings and files. 0 done, 1 not everything or refused, 2 usage.
int tune_plan(const Context& context, const TuneWords& words);
int tune_apply(const Context& context, const TuneWords& words);
int tune_revert(const Context& context, const TuneWords& words);
// The exit code of the command; 128 + its signal when that ended it.
int tune_shield(const Context& context, const TuneWords& words);

// Requests from the command line to a robot, and their answers.

using control::Answer;
using control::Json;
using control::Refusal;
using control::value_of;

inline constexpr int kQuickMs = 10'000;
inline constexpr int kCompileMs = 180'000;

// The value of a result; else throws a Refusal with this code and next step.
template <class T>
T value_of(Result<T> result, const char* code, const char* next) {
  if (!result) throw Refusal{code, result.message(), next};
  return std::move(*result);
}

// Sends one request to the context's robot. Throws the Refusal.
Json ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms = kQuickMs);
// The same, but returns a refusal instead of throwing it.
Answer try_ask(const Context& context, const std::string& verb, const Json& args, int timeout_ms = kQuickMs);

// The name of the context's robot, also when its supervisor does not answer. Throws the Refusal.
std::string which_robot(const Context& context);

// The connection, for more than one request. A stopped or silent supervisor, or a Spine without one, is reported within
// 2 s.
std::variant<control::Client, Refusal> connect(const Context& context);

// Prints a refusal (stderr, or one JSON document on stdout) and returns its exit code.
int refuse(const Context& context, const Refusal& refusal);

// Prints a result: JSON as it is, else through `print`. Returns 0.
int finish(const Context& context, const Json& result, const std::function<void(const Json&)>& print);

// Fields of answers as text, and what several verbs print.

// A field of an answer; 0 and "-" when it is missing or null (JSON has no NaN).
double number(const Json& object, const char* key);
std::string word(const Json& object, const char* key);

// "a, b": the texts of an array.
std::string listed(const Json& words);

// A line for each of the `warnings` and `hints` of this object.
std::string warning_lines(const Json& from, const char* indent);
// What the compile service took off or replaced around a law's code, one line each.
std::string cleaned_lines(const Json& from);

// Prints what a command of the Spine has done.
void print_command(const std::string& verb, const Json& result);

}  // namespace lithe::cli
