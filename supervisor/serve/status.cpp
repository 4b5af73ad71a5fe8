// SPDX-License-Identifier: Apache-2.0
#include "supervisor/serve/status.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "spine/core/host/cores.hpp"
#include "spine/core/host/interrupts.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/frames.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/robot/cores/cpu_plan.hpp"
#include "supervisor/bus/words.hpp"

namespace lithe::control {

namespace {

Json quantiles_json(const Quantiles& q) {
  return {{"p50", q.p50_us}, {"p99", q.p99_us}, {"p999", q.p999_us}, {"max", q.max_us}};
}

Json joint_status_json(std::uint32_t status) {
  Json words = Json::array();
  const std::pair<std::uint32_t, const char*> bits[] = {
      {wire::joint_status::kFault, "fault"},       {wire::joint_status::kWatchdog, "watchdog"},
      {wire::joint_status::kLost, "lost"},         {wire::joint_status::kNotHomed, "not_homed"},
      {wire::joint_status::kConflict, "conflict"}, {wire::joint_status::kGarbled, "garbled"},
      {wire::joint_status::kNotReady, "not_ready"}};
  for (const auto& [bit, word] : bits)
    if ((status & bit) != 0) words.push_back(word);
  if ((status & wire::joint_status::kFresh) == 0) words.push_back("stale");
  return words;
}

// JSON has no NaN.
Json number_or_null(double value) { return std::isfinite(value) ? Json(value) : Json(); }

// Null: the drive does not answer now, or its kind is unknown.
Json drive_json(const robot::RobotConfig& robot, const wire::Telemetry& now, std::size_t joint) {
  const std::uint32_t status = now.joint_status[joint];
  if ((status & wire::joint_status::kFresh) == 0 || joint >= robot.joints.size()) return nullptr;
  return bus::drive_words(robot.devices[robot.joints[joint].device].kind, status);
}

Json joints_json(const wire::RobotInfo& info, const robot::RobotConfig& robot, const wire::Telemetry& now) {
  Json joints = Json::array();
  const std::size_t count = std::min<std::size_t>(now.joint_count, wire::kNj);
  for (std::size_t j = 0; j < count; ++j) {
    joints.push_back({{"name", name_at(info.joint_name, j)},
                      {"group", name_at(info.joint_group, j)},
                      {"rung", std::string(to_string(static_cast<wire::Rung>(now.joint_rung[j])))},
                      {"fault", std::string(to_string(static_cast<wire::Fault>(now.joint_fault[j])))},
                      {"position_rad", now.position_rad[j]},
                      {"position_min_rad", info.position_min_rad[j]},
                      {"position_max_rad", info.position_max_rad[j]},
                      {"velocity_rad_s", now.velocity_rad_s[j]},
                      {"torque_nm", now.torque_nm[j]},
                      {"setpoint_position_rad", now.setpoint_position_rad[j]},
                      {"command_torque_nm", now.command_torque_nm[j]},
                      {"problems", joint_status_json(now.joint_status[j])},
                      {"drive", drive_json(robot, now, j)},
                      {"drive_state", std::string(to_string(static_cast<wire::DriveState>(now.drive_state[j])))},
                      {"drive_current_a", number_or_null(now.drive_current_a[j])},
                      {"drive_voltage_v", number_or_null(now.drive_voltage_v[j])},
                      {"drive_power_w", number_or_null(now.drive_power_w[j])},
                      {"drive_temperature_degc", number_or_null(now.drive_temperature_degc[j])}});
  }
  return joints;
}

Json inputs_json(const wire::RobotInfo& info, const wire::Telemetry& now) {
  Json inputs = Json::object();
  for (std::size_t i = 0; i < std::min<std::size_t>(info.input_count, wire::kNin); ++i)
    inputs[name_at(info.input_name, i)] = number_or_null(now.input[i]);
  return inputs;
}

Json sensors_json(const wire::RobotInfo& info, const wire::Telemetry& now) {
  Json sensors = Json::object();
  for (std::size_t i = 0; i < std::min<std::size_t>(info.sensor_count, wire::kNs); ++i)
    sensors[name_at(info.sensor_name, i)] = number_or_null(now.sensor[i]);
  return sensors;
}

// Counters of each bus since the Spine started. Empty for an older Spine, or when its memory cannot be read.
Json buses_json(const std::string& robot) {
  Json buses = Json::array();
  const auto frames = ipc::Segment<ipc::FramesMemory>::attach(robot, ipc::Access::read);
  if (!frames) return buses;
  const auto count = [](const std::uint64_t& word) { return ipc::load_word(word, std::memory_order_relaxed); };
  for (const ipc::BusCounts& bus : (*frames)->buses) {
    const std::string name = text_of(bus.name);
    if (name.empty()) break;
    buses.push_back({{"name", name},
                     {"sent", count(bus.sent)},
                     {"received", count(bus.received)},
                     {"refused", count(bus.refused)},
                     {"late", count(bus.late)},
                     {"malformed", count(bus.malformed)},
                     {"errors", count(bus.errors)},
                     {"reopened", count(bus.reopened)}});
  }
  return buses;
}

Json health_json(const ipc::HealthMemory& health) {
  const auto count = [](const std::uint64_t& word) { return ipc::load_word(word, std::memory_order_relaxed); };
  return {{"plans_torn", count(health.plans_torn)},
          {"brain_violations", count(health.brain_violations)},
          {"control_violations", count(health.control_violations)},
          {"stage_violations", count(health.stage_violations)}};
}

Json params_of(const wire::LawInfo& law, const wire::Params* live) {
  Json list = Json::array();
  for (std::uint32_t i = 0; i < law.param_count; ++i) {
    const bool is_live = live != nullptr && live->law_id == law.law_id && i < live->count;
    list.push_back({{"name", name_at(law.param_name, i)},
                    {"value", is_live ? live->value[i] : law.param_value[i]},
                    {"min", law.param_min[i]},
                    {"max", law.param_max[i]}});
    if (is_live && live->value[i] != law.param_value[i]) list.back()["at_commit"] = law.param_value[i];
  }
  return list;
}

// Null where nobody knows: that is not none.
Json interrupts_json(int cpu) {
  const Result<std::vector<Interrupt>> found = interrupts_of(cpu);
  Json named = Json::array();
  for (std::size_t i = 0; found && i < std::min(found->size(), kInterruptsNamed); ++i)
    named.push_back({{"number", (*found)[i].number}, {"name", (*found)[i].name}});
  return {{"count", found ? Json(found->size()) : Json(nullptr)},
          {"named", std::move(named)},
          {"words", interrupt_words(found)}};
}

// Whether the kernel keeps other threads off the Spine's core, read now for the tick thread.
Json spine_core_json(const SpineLink& spine, const robot::SpineConfig& wanted) {
  const wire::RobotInfo& info = spine.info();
  // The thread's group: under a shield, only threads that asked for the core have joined the partition.
  const IsolatedCores isolated =
      isolated_cores(info.tid_spine != 0 ? static_cast<pid_t>(info.tid_spine) : spine.spine_pid());
  const int cpu = static_cast<int>(info.cpu_spine);
  const bool shared = info.cpu_spine == info.cpu_housekeeping || info.cpu_spine == info.cpu_brain ||
                      (info.transport_inline == 0 && info.cpu_spine == info.cpu_transport);
  const char* const names[] = {"none", "boot", "cpuset"};
  const std::vector<int> pinned = allowed_cpus(static_cast<pid_t>(info.tid_spine));
  std::string words = robot::isolation_words(isolated, cpu);
  if (info.tid_spine != 0 && !pinned.empty() && pinned != std::vector<int>{cpu})
    words += fmt::format("; the thread that ticks is NOT pinned to it, it may run on {}", cpu_list(pinned));
  return {{"isolation", names[static_cast<std::size_t>(isolated.how(cpu))]},
          {"isolated_cores", cpu_list(isolated.all())},
          {"timer_tick", !isolated.is_tickless(cpu)},
          {"why", robot::why_spine(cpu, shared, wanted, isolated)},
          {"interrupts", interrupts_json(cpu)},
          {"words", words}};
}

// What is on probation: the law, or new parameters of a confirmed law.
Json probation_json(std::uint32_t flags) {
  namespace flag = wire::telemetry_flag;
  const bool on = (flags & flag::kOnProbation) != 0, params = (flags & flag::kParamsOnProbation) != 0;
  return {{"of", !on ? "none" : params ? "params" : "law"}, {"unproven", (flags & flag::kUnproven) != 0}};
}

// How far the Brain's heartbeats are ahead of the Spine's clock, which cannot tell their age then; null: not at all.
Json brain_ahead_s(const SpineLink& spine, const wire::Telemetry& now) {
  const std::int64_t ahead_ns = spine.brain_heartbeat_ns() - monotonic_ns();
  return now.brain_age_ns < 0 && ahead_ns > 0 ? Json(static_cast<double>(ahead_ns) * 1e-9) : Json(nullptr);
}

}  // namespace

std::string told_by_drive(robot::DeviceKind kind, std::uint32_t joint_status) {
  return bus::drive_words(kind, joint_status);
}

Json status_json(const SpineLink& spine, const robot::RobotConfig& robot) {
  wire::Telemetry now{};
  const bool any = spine.latest(now);
  const wire::RobotInfo& info = spine.info();
  const auto law = spine.running_law();
  const ipc::SpineMemory& memory = spine.memory();
  return {{"robot", text_of(info.robot)},
          {"mode", std::string(to_string(static_cast<wire::Mode>(now.mode)))},
          {"fault", std::string(to_string(static_cast<wire::Fault>(now.fault)))},
          {"recovering", (now.flags & wire::telemetry_flag::kRecovering) != 0},
          {"law", law ? Json(text_of(law->info.name)) : Json(nullptr)},
          {"law_id", now.law_id},
          {"params", law ? law->values : Json(nullptr)},
          {"probation", probation_json(now.flags)},
          {"law_suspected", (now.flags & wire::telemetry_flag::kLawSuspected) != 0 ? Json(true) : Json(nullptr)},
          {"rate_hz", info.rate_hz},
          {"tick", now.tick},
          {"age_ms", any ? Json(static_cast<double>(monotonic_ns() - now.release_ns) * 1e-6) : Json(nullptr)},
          {"missed_releases", now.missed_releases},
          {"late_samples", now.late_samples},
          {"plan", std::string(to_string(static_cast<wire::PlanState>(now.plan_state)))},
          {"setpoint_age_ms",
           now.setpoint_age_ns < 0 ? Json(nullptr) : Json(static_cast<double>(now.setpoint_age_ns) * 1e-6)},
          {"brain_age_ms", now.brain_age_ns < 0 ? Json(nullptr) : Json(static_cast<double>(now.brain_age_ns) * 1e-6)},
          {"brain_ahead_s", brain_ahead_s(spine, now)},
          {"release_jitter_us", quantiles_json(spine.quantiles(memory.release_jitter))},
          {"handoff_us", quantiles_json(spine.quantiles(memory.handoff))},
          {"law_us", quantiles_json(spine.quantiles(memory.law))},
          {"guard_us", quantiles_json(spine.quantiles(memory.guard))},
          {"tick_us", quantiles_json(spine.quantiles(memory.tick))},
          {"bus_us", quantiles_json(spine.quantiles(memory.bus))},
          {"health", health_json(memory.health)},
          {"joints", joints_json(info, robot, now)},
          {"sensors", sensors_json(info, now)},
          {"inputs", inputs_json(info, now)},
          {"buses", buses_json(text_of(info.robot))},
          {"cpus",
           {{"spine", info.cpu_spine},
            {"transport", info.cpu_transport},
            {"brain", info.cpu_brain},
            {"housekeeping", info.cpu_housekeeping},
            {"transport_inline", info.transport_inline != 0},
            {"spine_core", spine_core_json(spine, robot.spine)}}},
          {"loader", info.arena_base != 0 ? "arena" : "dlopen"},
          {"lost", text_of(info.notes)},
          {"config", text_of(info.config_path)},
          {"spine_pid", spine.spine_pid()}};
}

Answer params_json(const SpineLink& spine) {
  wire::Telemetry now{};
  const auto law = spine.latest(now) ? spine.law(now.law_id) : std::nullopt;
  if (!law) return Refusal{"refused_law", "no law is running, so there are no parameters", "swap a law in first"};
  const auto live = spine.params();
  return Json{
      {"law", text_of(law->name)}, {"law_id", law->law_id}, {"params", params_of(*law, live ? &*live : nullptr)}};
}

Json resident_json(const SpineLink& spine) {
  const wire::Telemetry now = spine.now();
  Json list = Json::array();
  const auto live = spine.params();
  for (const wire::LawInfo& law : spine.laws()) {
    Json probes = Json::array();
    for (std::uint32_t i = 0; i < std::min<std::uint32_t>(law.probe_count, wire::kNp); ++i)
      probes.push_back(name_at(law.probe_name, i));
    list.push_back({{"law", text_of(law.name)},
                    {"law_id", law.law_id},
                    {"active", law.law_id == now.law_id},
                    {"slot", law.slot == 0 ? Json(nullptr) : Json(law.slot)},
                    {"params", params_of(law, law.law_id == now.law_id && live ? &*live : nullptr)},
                    {"probes", std::move(probes)}});
  }
  return list;
}

}  // namespace lithe::control
