// SPDX-License-Identifier: Apache-2.0
#include "lawd/dry_run.hpp"

#include <cxxabi.h>
#include <dlfcn.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <memory>

#include "lawd/child.hpp"
#include "spine/law/resident.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;

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

// A slow sine that the joints follow with a small lag, as on a healthy robot.
void benign_input(Tick& t, std::uint64_t k, std::uint32_t joints) {
  t.tick = k;
  t.dt_s = 1e-3;
  t.t_s = static_cast<double>(k) * t.dt_s;
  t.t_ns = static_cast<std::int64_t>(k) * 1'000'000;
  t.joints = joints;
  for (std::uint32_t j = 0; j < joints; ++j) {
    const double w = std::numbers::pi, phase = w * t.t_s + 0.1 * j;
    t.setpoint_position_rad[j] = 0.5 * std::sin(phase);
    t.setpoint_velocity_rad_s[j] = 0.5 * w * std::cos(phase);
    t.setpoint_acceleration_rad_s2[j] = -0.5 * w * w * std::sin(phase);
    t.position_rad[j] = 0.48 * std::sin(phase - 0.05);
    t.velocity_rad_s[j] = 0.48 * w * std::cos(phase - 0.05);
    t.torque_nm[j] = 0.05 * std::sin(phase);
  }
}

// The first output that is not a number, by name; empty when all are finite.
std::string bad_output(const Effort& u, const std::array<double, kMaxProbes>& probes, const LitheLaw& law,
                       std::uint32_t joints) {
  for (std::uint32_t j = 0; j < joints; ++j) {
    const std::string at = "[" + std::to_string(j) + "]";
    if (!std::isfinite(u.torque_nm[j])) return "torque_nm" + at;
    if (std::isinf(u.position_rad[j])) return "position_rad" + at;
    if (!std::isfinite(u.velocity_rad_s[j])) return "velocity_rad_s" + at;
    if (!std::isfinite(u.kp_nm_rad[j])) return "kp_nm_rad" + at;
    if (!std::isfinite(u.kd_nm_s_rad[j])) return "kd_nm_s_rad" + at;
  }
  for (std::uint32_t i = 0; i < law.probe_count; ++i) {
    if (!std::isfinite(probes[i])) return std::string("probe ") + law.probes[i];
  }
  return "";
}

std::int64_t now_ns() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000ll + now.tv_nsec;
}

// The child tells how far it came, one JSON line at a time: after a crash the last line says where it was.
void tell(int fd, const json& line) {
  const std::string text = line.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
  if (write(fd, text.data(), text.size()) < 0) _exit(3);
}

int dry_steps(int fd, const LitheLaw& law, std::uint32_t joints, std::uint64_t steps) {
  auto resident = std::make_unique<law::Resident>();
  law::reset_resident(*resident, law);
  Tick tick;
  Effort effort;
  std::array<double, kMaxProbes> probes{};
  std::int64_t total_ns = 0;
  for (std::uint64_t k = 0; k < steps; ++k) {
    benign_input(tick, k, joints);
    const std::int64_t start = now_ns();
    resident->step(tick, effort, probes);
    total_ns += now_ns() - start;
    const std::string bad = bad_output(effort, probes, law, joints);
    if (bad.empty()) continue;
    tell(fd, {{"refused", bad + " is not finite in dry step " + std::to_string(k) +
                              ", on harmless inputs: look for a division by zero, sqrt or log of a negative number, "
                              "or a gain that diverges"}});
    return 1;
  }
  tell(fd, {{"done", true},
            {"step_ns", static_cast<double>(total_ns) / static_cast<double>(std::max<std::uint64_t>(steps, 1))}});
  return 0;
}

// dlopen's words, without our scratch path; an unknown name is the one mistake a law can make here.
std::string load_failure(const std::string& words) {
  constexpr std::string_view kUndefined = "undefined symbol: ";
  const auto at = words.find(kUndefined);
  if (at == std::string::npos) return "cannot load the law: " + words;
  const std::string symbol = words.substr(at + kUndefined.size());
  int status = 0;
  char* readable = abi::__cxa_demangle(symbol.c_str(), nullptr, nullptr, &status);
  const std::string name = status == 0 ? readable : symbol;
  std::free(readable);
  return "the law uses " + name + ", which it does not define: a law may use itself, the contract and <cmath> only";
}

int try_law(int fd, const LitheLaw& law, std::uint32_t joints, std::uint64_t steps) {
  char text[192];
  if (*law::describe_mismatch(law, text, sizeof text) != '\0') {
    tell(fd, {{"refused", text}});
    return 1;
  }
  tell(fd, {{"law", describe_json(law)}});
  return dry_steps(fd, law, joints, steps);
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
  if (outcome.timed_out) return "the law did not return " + where + ": look for a loop without an end";
  if (outcome.signal != 0) return "the law crashed " + where + ": " + signal_text(outcome.signal);
  return "the law ended its process " + where + " (exit code " + std::to_string(outcome.exit_code) +
         "): a law may not call exit";
}

const Limits kLimits{3'000, 2, std::size_t{1} << 30, 0};

DryRun read_outcome(const Outcome& outcome) {
  DryRun result;
  result.stage = "load";
  std::size_t start = 0;
  bool done = false;
  while (start < outcome.output.size()) {
    std::size_t end = outcome.output.find('\n', start);
    if (end == std::string::npos) end = outcome.output.size();
    const json line = json::parse(outcome.output.substr(start, end - start), nullptr, false);
    start = end + 1;
    if (!line.is_object()) continue;
    if (line.contains("law")) result.law = line["law"], result.stage = "dry_run";
    if (line.contains("refused")) result.reason = line["refused"].get<std::string>();
    if (line.contains("done")) done = true, result.step_ns = line.value("step_ns", 0.0);
  }
  result.ok = done && outcome.clean() && result.reason.empty();
  if (!result.ok && result.reason.empty()) result.reason = death(outcome, result.stage);
  return result;
}

}  // namespace

DryRun dry_run(const std::string& object_path, std::uint32_t joints, std::uint64_t steps) {
  return read_outcome(run_child([&](int fd) { return child(fd, object_path, joints, steps); }, kLimits));
}

DryRun dry_run_placed(std::uint64_t entry, std::uint32_t joints, std::uint64_t steps) {
  const auto* law = reinterpret_cast<const LitheLaw*>(entry);
  return read_outcome(run_child([&](int fd) { return try_law(fd, *law, joints, steps); }, kLimits));
}

}  // namespace lithe::lawd
