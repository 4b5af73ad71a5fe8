// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/spine/metrics.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <memory>
#include <string>
#include <vector>

#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"

namespace lithe::control {
namespace {

std::string read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return std::string(std::istreambuf_iterator<char>(file), {});
}

// The next word, cut off the front; empty at the end.
std::string_view word(std::string_view& text) {
  const std::size_t from = std::min(text.find_first_not_of(' '), text.size());
  const std::size_t to = std::min(text.find(' ', from), text.size());
  const std::string_view found = text.substr(from, to - from);
  text.remove_prefix(to);
  return found;
}

Json difference(const std::optional<std::uint64_t>& before, const std::optional<std::uint64_t>& after) {
  return before && after ? Json(*after - std::min(*before, *after)) : Json(nullptr);
}

// The window before or after the commit, one value per tick.
struct Side {
  std::vector<std::uint32_t> jitter_ns, handoff_ns;
  double step_share = -1.0;  // largest torque step, as a share of the slew bound
  double step_nm = 0.0, bound_nm = 0.0;
  std::size_t joint = 0;

  void add(const wire::Telemetry& record) {
    jitter_ns.push_back(record.release_jitter_ns);
    handoff_ns.push_back(record.handoff_ns);
  }
  void step(const wire::Telemetry& from, const wire::Telemetry& to, const wire::RobotInfo& info) {
    for (std::size_t j = 0; j < std::min<std::size_t>(to.joint_count, wire::kNj); ++j) {
      const double by_nm = std::abs(to.command_torque_nm[j] - from.command_torque_nm[j]);
      const double most_nm = info.torque_slew_nm_s[j] / info.rate_hz;
      if (most_nm > 0 && by_nm / most_nm > step_share) {
        step_share = by_nm / most_nm;
        step_nm = by_nm;
        bound_nm = most_nm;
        joint = j;
      }
    }
  }
  static Json quantiles(std::vector<std::uint32_t>& times_ns) {
    if (times_ns.empty()) return nullptr;
    std::ranges::sort(times_ns);
    return {{"p50_us", times_ns[times_ns.size() / 2] * 1e-3}, {"max_us", times_ns.back() * 1e-3}};
  }
  // Null when there are no two consecutive ticks to compare.
  Json to_json() {
    const bool stepped = step_share >= 0;
    return {{"ticks", jitter_ns.size()},
            {"release_jitter", quantiles(jitter_ns)},
            {"handoff", quantiles(handoff_ns)},
            {"largest_step_nm", stepped ? Json(step_nm) : Json(nullptr)},
            {"slew_bound_nm", stepped ? Json(bound_nm) : Json(nullptr)},
            {"step_joint", stepped ? Json(joint) : Json(nullptr)}};
  }
};

// Calls `see` for each record of ticks (from, to] that is still in the ring, oldest first.
template <class See>
void each_record(const SpineLink& spine, std::uint64_t from, std::uint64_t to, See see) {
  auto now = std::make_unique<wire::Telemetry>();
  if (!spine.latest(*now) || to <= from) return;
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> ring(spine.memory().telemetry);
  ring.rewind(now->tick - std::min(now->tick, from) + 1);
  // Test empty(): next() is false also for a record that was overwritten while it was read.
  while (!ring.empty()) {
    if (!ring.next(*now) || now->tick <= from) continue;
    if (now->tick > to) break;
    see(*now);
  }
}

}  // namespace

void read_interrupts(std::string_view text, std::uint32_t cpu, CoreCounts& counts) {
  std::string_view head = text.substr(0, text.find('\n'));
  const std::string wanted = fmt::format("CPU{}", cpu);
  std::size_t column = 0;
  for (std::string_view each = word(head); each != wanted; each = word(head), ++column)
    if (each.empty()) return;  // /proc/interrupts has no column for this core
  for (std::string_view line : lines_in(text)) {
    const std::string_view name = word(line);
    for (std::size_t i = 0; i < kInterrupts.size(); ++i) {
      if (name.size() == kInterrupts[i].size() + 1 && name.starts_with(kInterrupts[i]) && name.back() == ':') {
        for (std::size_t skipped = 0; skipped < column; ++skipped) (void)word(line);
        counts.interrupts[i] = whole_number<std::uint64_t>(word(line));
      }
    }
  }
}

// Fields 10 and 12 of /proc/PID/stat; the name in parentheses before them may contain any character.
void read_faults(std::string_view stat, CoreCounts& counts) {
  const std::size_t name_end = stat.rfind(')');
  if (name_end == std::string_view::npos) return;
  stat.remove_prefix(name_end + 1);
  for (int field = 3; field <= 12; ++field) {
    const std::string_view text = word(stat);
    if (field == 10)
      counts.minor_faults = whole_number<std::uint64_t>(text);
    else if (field == 12)
      counts.major_faults = whole_number<std::uint64_t>(text);
  }
}

CoreCounts count_core(pid_t spine, const wire::RobotInfo& info) {
  CoreCounts counts;
  counts.t_ns = monotonic_ns();
  read_interrupts(read("/proc/interrupts"), info.cpu_spine, counts);
  if (info.tid_spine != 0) read_faults(read(fmt::format("/proc/{}/task/{}/stat", spine, info.tid_spine)), counts);
  return counts;
}

Json counts_json(const CoreCounts& before, const CoreCounts& after) {
  const bool both = before.t_ns != 0 && after.t_ns != 0;
  return {{"seconds", both ? Json(static_cast<double>(after.t_ns - before.t_ns) * 1e-9) : Json(nullptr)},
          {"minor_faults", difference(before.minor_faults, after.minor_faults)},
          {"major_faults", difference(before.major_faults, after.major_faults)},
          {"tlb", difference(before.interrupts[0], after.interrupts[0])},
          {"cal", difference(before.interrupts[1], after.interrupts[1])},
          {"res", difference(before.interrupts[2], after.interrupts[2])}};
}

Json measure_commit(const SpineLink& spine, std::uint64_t commit_tick) {
  const wire::RobotInfo& info = spine.info();
  const auto window = static_cast<std::uint64_t>(std::max(1.0, kWindowS * info.rate_hz));
  auto last = std::make_unique<wire::Telemetry>();
  Side before, after;
  Json first_call_ns = nullptr;
  std::optional<std::uint32_t> missed_before;
  std::uint32_t missed_after = 0;
  const std::uint64_t from = commit_tick - std::min(commit_tick, window + 1);
  each_record(spine, from, commit_tick + window, [&](const wire::Telemetry& now) {
    Side& side = now.tick <= commit_tick ? before : after;
    side.add(now);
    if (last->tick != 0 && now.tick == last->tick + 1) side.step(*last, now, info);
    if (now.tick == commit_tick + 1) first_call_ns = now.law_ns;
    missed_before = missed_before.value_or(now.missed_releases);
    missed_after = now.missed_releases;
    *last = now;
  });
  if (!missed_before && !spine.latest(*last)) return nullptr;
  return {{"first_call_ns", first_call_ns},
          {"lost_ticks", missed_before ? Json(missed_after - *missed_before) : Json(nullptr)},
          {"before", before.to_json()},
          {"after", after.to_json()}};
}

namespace {

namespace flag = wire::telemetry_flag;
constexpr std::uint32_t kClamped =
    flag::kTorqueClamped | flag::kSlewClamped | flag::kPositionClamped | flag::kVelocityClamped | flag::kPowerClamped;
constexpr double kAll = 0.999;        // of torque_max_nm
constexpr double kClampedBy = 0.001;  // likewise: by less the guard changes nothing worth a word

double aligned_error_rad(const wire::Telemetry& record, std::size_t joint) {
  const std::int64_t woke_ns = record.release_ns + record.release_jitter_ns;
  const double older_s = record.sample_ns == 0 ? 0 : static_cast<double>(woke_ns - record.sample_ns) * 1e-9;
  return record.setpoint_position_rad[joint] - record.setpoint_velocity_rad_s[joint] * older_s -
         record.position_rad[joint];
}

void see(const wire::Telemetry& record, const wire::RobotInfo& info, std::size_t j, JointControl& joint) {
  const double error_rad = aligned_error_rad(record, j), torque_nm = record.command_torque_nm[j];
  joint.rms_error_rad += error_rad * error_rad;  // the sums, until the end
  joint.rms_torque_nm += torque_nm * torque_nm;
  joint.max_error_rad = std::max(joint.max_error_rad, std::abs(error_rad));
  joint.max_torque_nm = std::max(joint.max_torque_nm, std::abs(torque_nm));
  joint.at_limit += std::abs(torque_nm) >= kAll * info.torque_max_nm[j] ? 1 : 0;
  const bool changed = std::abs(record.law_torque_nm[j] - torque_nm) > kClampedBy * info.torque_max_nm[j];
  joint.clamped += (record.flags & kClamped) != 0 && changed ? 1 : 0;
  const double jump_nm = law::Tremor::kJumpShare * info.torque_max_nm[j];
  joint.chatter_hz += joint.wanted.see(record.law_torque_nm[j], jump_nm).ticks > 0 ? 0.5 : 0;  // two turns are a period
  joint.sums.see({record.setpoint_position_rad[j], record.position_rad[j], record.velocity_rad_s[j],
                  record.setpoint_velocity_rad_s[j], torque_nm},
                 kAll * info.torque_max_nm[j]);
}

}  // namespace

std::uint32_t law_in(const SpineLink& spine, std::uint64_t tick) {
  std::uint32_t law_id = 0;
  each_record(spine, tick - 1, tick, [&](const wire::Telemetry& record) { law_id = record.law_id; });
  return law_id;
}

LawControl measure_control(const SpineLink& spine, std::uint32_t law_id, std::uint64_t from_tick,
                           std::uint64_t to_tick) {
  const wire::RobotInfo& info = spine.info();
  LawControl found;
  found.joints.resize(std::min<std::size_t>(info.joint_count, wire::kNj));
  auto last = std::make_unique<wire::Telemetry>();
  each_record(spine, from_tick, to_tick, [&](const wire::Telemetry& record) {
    if (record.law_id != law_id || record.mode != static_cast<std::uint32_t>(wire::Mode::active)) return;
    ++found.ticks;
    found.clamped += (record.flags & kClamped) != 0 ? 1 : 0;
    const bool follows = last->tick != 0;
    if (follows) found.missed += record.missed_releases - std::min(record.missed_releases, last->missed_releases);
    for (std::size_t j = 0; j < found.joints.size(); ++j) {
      see(record, info, j, found.joints[j]);
      if (follows) found.joints[j].moved_rad += std::abs(record.position_rad[j] - last->position_rad[j]);
    }
    *last = record;
  });
  const double ticks = std::max(1u, found.ticks);
  found.clamped /= ticks;
  for (JointControl& joint : found.joints) {
    joint.rms_error_rad = std::sqrt(joint.rms_error_rad / ticks);
    joint.rms_torque_nm = std::sqrt(joint.rms_torque_nm / ticks);
    joint.at_limit /= ticks;
    joint.clamped /= ticks;
    joint.chatter_hz *= info.rate_hz / ticks;
  }
  return found;
}

}  // namespace lithe::control
