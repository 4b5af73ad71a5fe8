// SPDX-License-Identifier: Apache-2.0
#include "lawd/run/dry_run.hpp"

#include <dlfcn.h>
#include <fenv.h>
#include <signal.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <numeric>
#include <vector>

#include "lawd/run/child.hpp"
#include "spine/core/host/signals.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"
#include "spine/law/dry_inputs.hpp"
#include "spine/law/resident.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

constexpr int kRepetitions = 5;
constexpr std::int64_t kPatienceNs = 500'000'000;  // the child has two seconds of the processor
constexpr const char* kKindNames[] = {"none",  "bool",   "int8",  "uint8",  "int16",   "uint16",
                                      "int32", "uint32", "int64", "uint64", "float32", "float64"};

json describe_json(const LitheLaw& law) {
  json out = {{"name", law.name}, {"abi", law.abi}, {"state_size", law.state_size}};
  out["params"] = out["state"] = out["probes"] = json::array();
  for (std::uint32_t i = 0; i < law.param_count; ++i) {
    const LitheParam& p = law.params[i];
    out["params"].push_back({{"name", p.name}, {"value", p.value}, {"min", p.min}, {"max", p.max}});
  }
  for (std::uint32_t i = 0; i < law.state_count; ++i) {
    const LitheStateField& f = law.state[i];
    out["state"].push_back({{"name", f.name}, {"type", kKindNames[f.kind]}, {"count", f.count}});
  }
  for (std::uint32_t i = 0; i < law.probe_count; ++i) out["probes"].push_back(law.probes[i]);
  return out;
}

// The child reports its progress, one JSON line per stage: after a crash the last line says where it was.
void tell(int fd, const json& line) {
  const std::string text = line.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
  if (write(fd, text.data(), text.size()) < 0) _exit(3);
}

// Runs `steps` steps from the default State. quickest_ns: fastest time of each step over all repetitions. Ends at the
// first output that is not finite: its name goes to `bad`, and the step's number is returned.
std::uint64_t dry_steps(const LitheLaw& law, std::uint32_t joints, std::uint64_t steps, law::Resident& resident,
                        std::vector<std::int64_t>& quickest_ns, std::array<char, 64>& bad) {
  law::reset_resident(resident, law);
  Tick tick;
  Effort effort;
  std::array<double, kMaxProbes> probes{};
  for (std::uint64_t k = 0; k < steps; ++k) {
    law::dry_input(tick, k, joints);
    const std::int64_t start = monotonic_ns();
    resident.step(tick, effort, probes);
    quickest_ns[k] = std::min(quickest_ns[k], monotonic_ns() - start);
    if (!law::outputs_are_finite(effort, probes, law, joints, bad.data(), bad.size())) return k;
  }
  return steps;
}

// The child's, for its handler.
int g_pipe = -1;
std::uint64_t g_base = 0;

// Tells where the law was, then lets the signal end it.
void on_death(int signal, siginfo_t*, void* context) {
  const auto pc = static_cast<unsigned long long>(program_counter(context) - g_base);
  char line[48];
  const int length = std::snprintf(line, sizeof line, "{\"pc\": %llu}\n", pc);
  if (write(g_pipe, line, static_cast<std::size_t>(length)) != length) _exit(3);
  ::signal(signal, SIG_DFL);
  ::raise(signal);  // blocked until this returns
}

// A crash, a loop without an end (SIGXCPU; SIGPROF on a busy machine: its time is up first), and what tell_place()
// makes the processor stop at. On a stack of its own, for a law that has used up its stack.
void listen_for_death(int fd, const LitheLaw& law) {
  static std::array<char, 64 << 10> memory;
  const stack_t stack{memory.data(), 0, memory.size()};
  Dl_info info{};
  if (dladdr(&law, &info) == 0 || sigaltstack(&stack, nullptr) != 0) return;
  g_pipe = fd;
  g_base = reinterpret_cast<std::uint64_t>(info.dli_fbase);
  struct sigaction action{};
  action.sa_sigaction = &on_death;
  action.sa_flags = SA_SIGINFO | SA_ONSTACK;
  for (const int signal : {SIGXCPU, SIGPROF, SIGSEGV, SIGBUS, SIGFPE, SIGILL}) sigaction(signal, &action, nullptr);
}

// Repeats the steps up to a bad one, before which `prepare` is called with its input. False: its output is not finite.
template <typename Prepare>
bool repeat(const LitheLaw& law, std::uint32_t joints, std::uint64_t bad_step, law::Resident& resident,
            const Prepare& prepare) {
  law::reset_resident(resident, law);
  Tick tick;
  Effort effort;
  std::array<double, kMaxProbes> probes{};
  for (std::uint64_t k = 0; k <= bad_step; ++k) {
    law::dry_input(tick, k, joints);
    if (k == bad_step) prepare(tick);
    resident.step(tick, effort, probes);
  }
  std::array<char, 64> bad{};
  return law::outputs_are_finite(effort, probes, law, joints, bad.data(), bad.size());
}

// Whether that step is fine with every sensor valid.
bool is_of_sensors(const LitheLaw& law, std::uint32_t joints, std::uint64_t bad_step, law::Resident& resident) {
  return repeat(law, joints, bad_step, resident, [](Tick& tick) {
    for (double& value : tick.sensor) value = std::isnan(value) ? 0.0 : value;
  });
}

// In the bad step the processor stops at the first invalid operation (a division by zero, 0/0, the root of a negative
// number). Not every processor can; then nothing is told.
void tell_place(const LitheLaw& law, std::uint32_t joints, std::uint64_t bad_step, law::Resident& resident) {
  repeat(law, joints, bad_step, resident, [](Tick&) {
    feclearexcept(FE_ALL_EXCEPT);
    feenableexcept(FE_INVALID | FE_DIVBYZERO);
  });
  fedisableexcept(FE_ALL_EXCEPT);
}

constexpr const char* kSensors =
    ", in which no sensor is valid (NaN): use t.sensor[i] only if std::isfinite(t.sensor[i])";
constexpr const char* kNotFinite =
    ", on harmless inputs: look for a division by zero, sqrt or log of a negative number, or a gain that diverges";

// The law itself is slow, not the machine, which may stand still in a step: many steps are slow, or one is each time.
bool is_slow_for_sure(const std::vector<std::int64_t>& quickest_ns, int repetitions) {
  if (quickest_ns.empty()) return false;
  const std::int64_t slowest_ns = *std::ranges::max_element(quickest_ns);
  const std::int64_t others_ns = std::accumulate(quickest_ns.begin(), quickest_ns.end(), std::int64_t{0}) - slowest_ns;
  return repetitions * others_ns > kPatienceNs || (repetitions > 1 && slowest_ns > kPatienceNs);
}

// A law does the same work in every repetition; a disturbance of the machine is different each time. So only a step
// that is slow every time counts.
int try_steps(int fd, const LitheLaw& law, std::uint32_t joints, std::uint64_t steps) {
  auto resident = std::make_unique<law::Resident>();
  std::vector<std::int64_t> quickest_ns(steps, std::numeric_limits<std::int64_t>::max());
  for (int repetition = 1; repetition <= kRepetitions; ++repetition) {
    std::array<char, 64> bad{};
    const std::uint64_t done = dry_steps(law, joints, steps, *resident, quickest_ns, bad);
    if (done < steps) {
      tell(fd, {{"refused", std::string(bad.data()) + " is not finite in dry step " + std::to_string(done) +
                                (is_of_sensors(law, joints, done, *resident) ? kSensors : kNotFinite)}});
      tell_place(law, joints, done, *resident);
      return 1;
    }
    if (is_slow_for_sure(quickest_ns, repetition)) break;
  }
  tell(fd, {{"done", true}, {"step_ns", steps == 0 ? 0 : *std::ranges::max_element(quickest_ns)}});
  return 0;
}

// dlopen's message without our scratch path. The usual error here is an unknown name.
std::string load_failure(const std::string& words) {
  constexpr std::string_view kUndefined = "undefined symbol: ";
  const auto at = words.find(kUndefined);
  if (at == std::string::npos) return "cannot load the law: " + words;
  return "the law uses " + readable(words.substr(at + kUndefined.size())) +
         ", which it does not define: a law may use itself, the contract and <cmath> only";
}

int try_law(int fd, const LitheLaw& law, std::uint32_t joints, std::uint64_t steps) {
  char text[192];
  if (*law::describe_mismatch(law, text, sizeof text) != '\0') {
    tell(fd, {{"refused", text}});
    return 1;
  }
  tell(fd, {{"law", describe_json(law)}});
  listen_for_death(fd, law);
  return try_steps(fd, law, joints, steps);
}

int child(int fd, const std::string& path, std::uint32_t joints, std::uint64_t steps) {
  void* handle = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr) {
    tell(fd, {{"refused", load_failure(dlerror())}});
    return 1;
  }
  const auto* law = static_cast<const LitheLaw*>(dlsym(handle, "lithe_law"));
  if (law == nullptr) {
    tell(fd, {{"refused", "the file exports no law: end it with LITHE_LAW(Type, \"name\");"}});
    return 1;
  }
  return try_law(fd, *law, joints, steps);
}

std::string death(const Outcome& outcome, const std::string& stage) {
  const std::string where = stage == "load" ? "while it was loaded" : "in a dry step on harmless inputs";
  if (outcome.timed_out)
    return "the law did not return " + where +
           ": look for a loop without an end, or with too many turns (a step has some microseconds)";
  if (outcome.signal != 0) return "the law crashed " + where + ": " + signal_text(outcome.signal);
  return "the law ended its process " + where + " (exit code " + std::to_string(outcome.exit_code) +
         "): a law may not call exit";
}

// A loop without an end has used up its processor time long before: the rest is for a machine that is busy.
const Limits kLimits{10'000, 2, std::size_t{1} << 30, 0};

DryRun read_outcome(const Outcome& outcome) {
  DryRun result;
  result.stage = "load";
  bool done = false;
  for (const std::string_view text : lines_in(outcome.output)) {
    const json line = json::parse(text, nullptr, false);
    if (!line.is_object()) continue;
    if (line.contains("law")) result.law = line["law"], result.stage = "dry_run";
    if (line.contains("refused")) result.reason = line["refused"].get<std::string>();
    if (line.contains("pc")) result.pc_offset = line.value("pc", std::uint64_t{0});
    if (line.contains("done")) done = true, result.step_ns = line.value("step_ns", 0.0);
  }
  result.ok = done && outcome.clean() && result.reason.empty();
  if (!result.ok && result.reason.empty()) {
    result.starved = outcome.starved;
    result.reason = outcome.starved ? starved_text("the dry run", outcome) : death(outcome, result.stage);
  }
  return result;
}

}  // namespace

DryRun dry_run(const std::string& object_path, std::uint32_t joints, std::uint64_t steps) {
  return read_outcome(run_child([&](int fd) { return child(fd, object_path, joints, steps); }, kLimits));
}

}  // namespace lithe::lawd
