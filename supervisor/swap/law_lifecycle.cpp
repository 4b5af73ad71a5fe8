// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/law_lifecycle.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>

#include "spine/law/diagnosis.hpp"
#include "supervisor/events/event_log.hpp"

namespace lithe::control {
namespace {

constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();

double rounded(double value) { return std::round(value * 1e5) / 1e5; }

Json side_json(const LawControl& side, std::size_t joint) {
  if (side.ticks == 0) return nullptr;
  const JointControl& seen = side.joints[joint];
  return {{"rms_error_rad", rounded(seen.rms_error_rad)}, {"max_error_rad", rounded(seen.max_error_rad)},
          {"rms_torque_nm", rounded(seen.rms_torque_nm)}, {"max_torque_nm", rounded(seen.max_torque_nm)},
          {"at_limit", rounded(seen.at_limit)},           {"moved_rad", rounded(seen.moved_rad)},
          {"chatter_hz", std::round(seen.chatter_hz)},    {"clamped", rounded(seen.clamped)}};
}

// The trial's own run of this law, if it had one: its rms error at this joint.
Json predicted(const Json& trial, std::size_t joint) {
  const Json loop = trial.value("report", Json::object()).value("loop", Json::object());
  const Json errors = loop.value("joint_rms_error_rad", Json::array());
  return joint < errors.size() && errors[joint].is_number() ? Json(rounded(errors[joint])) : Json(nullptr);
}

Json control_json(const LawControl& before, const LawControl& after, const LawControl& late,
                  const wire::RobotInfo& info, const Json& trial) {
  Json joints = Json::array();
  for (std::size_t j = 0; j < after.joints.size(); ++j) {
    joints.push_back({{"joint", joint_name(info, j)},
                      {"before", side_json(before, j)},
                      {"after", side_json(after, j)},
                      {"late_rms_error_rad", late.ticks == 0 ? Json() : Json(rounded(late.joints[j].rms_error_rad))},
                      {"predicted_rms_error_rad", predicted(trial, j)}});
  }
  const auto whole = [](const LawControl& side) {
    return Json{{"ticks", side.ticks}, {"missed_ticks", side.missed}, {"clamped", rounded(side.clamped)}};
  };
  return {{"before", whole(before)}, {"after", whole(after)}, {"joints", std::move(joints)}};
}

// What the joints did under a law that was rolled back, one sentence for each whose numbers are clear. `why` may name a
// frequency: "oscillating: joint wrist, 31 Hz, swings of ...".
Json explained(const LawControl& after, const wire::RobotInfo& info, const std::string& why) {
  const std::size_t unit = why.rfind(" Hz"), number = unit == std::string::npos ? unit : why.rfind(' ', unit - 1);
  const bool swings = why.starts_with("oscillating") && number != std::string::npos;
  const double swing_hz = swings ? std::strtod(why.c_str() + number, nullptr) : 0;
  Json told = Json::array();
  for (std::size_t j = 0; j < after.joints.size(); ++j) {
    const std::string name = joint_name(info, j);
    if (why.find("joint " + name) == std::string::npos) continue;
    const law::Diagnosis found =
        law::diagnose(after.joints[j].sums, {name.c_str(), info.torque_max_nm[j], swing_hz, true, {}});
    if (found.kind != law::Diagnosis::Kind::none) told.push_back(text_of(found.text));
  }
  return told;
}

}  // namespace

LawLifecycle::LawLifecycle(const SpineLink& spine, Keep keep, Locate locate, Explain explain)
    : spine_(spine),
      keep_(std::move(keep)),
      locate_(std::move(locate)),
      explain_(std::move(explain)),
      faults_(spine.memory().law_faults) {}

void LawLifecycle::follow(SwapState swap, CertificateFiles::Page record, const CoreCounts& before,
                          std::int64_t now_ns) {
  measure_all();
  for (Life& each : lives_) measure_control(each);
  Life* last = running_.empty() ? nullptr : of_law(running_.back());
  if (last != nullptr && last->swap.request().terms.probation_s > 0 && !last->swap.reached(Stage::confirmed)) {
    last->swap.note("probation", fmt::format("cut short by request {}", swap.request_id()));
    keep_(last->swap, last->record);
  }
  running_.push_back(swap.law_id());
  const double control_s = std::clamp(swap.request().terms.probation_s, 0.1, kControlS);
  const auto control_at_ns = now_ns + kMeasureAfterNs + static_cast<std::int64_t>(control_s * 1e9);
  lives_.push_back({std::move(swap), std::move(record), before, now_ns + kMeasureAfterNs, control_at_ns, ""});
}

void LawLifecycle::serve(std::int64_t now_ns) {
  for (Life& each : lives_) {
    if (each.measure_at_ns <= now_ns) measure(each);
    if (each.control_at_ns <= now_ns) measure_control(each);
  }
}

void LawLifecycle::measure_all() {
  for (Life& each : lives_) measure(each);
}

void LawLifecycle::measure(Life& life) {
  if (std::exchange(life.measure_at_ns, 0) == 0) return;
  Json measured = measure_commit(spine_, life.swap.commit_tick());
  if (measured.is_object()) {
    measured["core"] = counts_json(life.before, count_core(spine_.spine_pid(), spine_.info()));
    life.swap.note("measured", std::move(measured));
    keep_(life.swap, life.record);
  }
}

void LawLifecycle::measure_control(Life& life, const std::string& why) {
  if (std::exchange(life.control_at_ns, kNever) == kNever) return;
  const std::uint64_t commit = life.swap.commit_tick();
  const double control_s = std::clamp(life.swap.request().terms.probation_s, 0.1, kControlS);
  const auto window = static_cast<std::uint64_t>(control_s * spine_.info().rate_hz);
  const LawControl before =
      control::measure_control(spine_, law_in(spine_, commit), commit - std::min(commit, window), commit);
  const LawControl after = control::measure_control(spine_, life.swap.law_id(), commit, commit + window);
  if (after.ticks == 0) return;
  // What is left when the joints have come nearer to their setpoints.
  const LawControl late =
      control::measure_control(spine_, life.swap.law_id(), commit + 2 * window / 3, commit + window);
  Json told = control_json(before, after, late, spine_.info(), life.swap.certificate().value("trial", Json::object()));
  if (Json seen = why.empty() ? Json::array() : explained(after, spine_.info(), why); !seen.empty())
    told["seen"] = seen;
  life.swap.note("control", std::move(told));
  keep_(life.swap, life.record);
}

LawLifecycle::Life* LawLifecycle::of_request(std::uint64_t request_id) {
  const auto found =
      std::ranges::find_if(lives_, [&](const Life& each) { return each.swap.request_id() == request_id; });
  return found == lives_.end() ? nullptr : &*found;
}

LawLifecycle::Life* LawLifecycle::of_law(std::uint32_t law_id) {
  const auto found = std::ranges::find_if(lives_, [&](const Life& each) { return each.swap.law_id() == law_id; });
  return found == lives_.end() ? nullptr : &*found;
}

void LawLifecycle::note(std::uint64_t request_id, const std::string& section, Json what) {
  if (Life* life = of_request(request_id)) {
    life->swap.note(section, std::move(what));
    keep_(life->swap, life->record);
  }
}

void LawLifecycle::on_event(const wire::Event& event) {
  switch (static_cast<wire::EventKind>(event.kind)) {
    case wire::EventKind::law_faulted:
      return faulted(event);
    case wire::EventKind::law_rolled_back:
      return rolled_back(event);
    case wire::EventKind::law_unproven:
      if (Life* life = of_request(event.request_id);
          event.value == 0 && life && life->swap.mark(Stage::unproven, text_of(event.text), event.t_ns)) {
        keep_(life->swap, life->record);
      }
      return;
    case wire::EventKind::law_confirmed:
      if (Life* life = of_request(event.request_id); life && life->swap.mark(Stage::confirmed, "", event.t_ns))
        keep_(life->swap, life->record);
      return;
    case wire::EventKind::law_suspected:
      return note(event.request_id, "suspected", {{"tick", event.tick}, {"why", text_of(event.text)}});
    case wire::EventKind::law_retired:
      return retired(event);
    default:
      return;
  }
}

// Details of a law fault are in a separate ring, written before the event. Records whose event has not arrived yet stay
// queued.
std::optional<wire::LawFault> LawLifecycle::record_of(const wire::Event& event) {
  wire::LawFault fault{};
  while (!faults_.empty())
    if (faults_.next(fault)) unreported_.push_back(fault);
  const auto is_it = [&](const wire::LawFault& each) {
    return each.request_id == event.request_id && each.tick == event.tick;
  };
  const auto found = std::ranges::find_if(unreported_, is_it);
  std::optional<wire::LawFault> record;
  if (found != unreported_.end()) {
    record = *found;
    unreported_.erase(found);
  }
  while (unreported_.size() > wire::spine_segment::kLawFaultsDepth) unreported_.pop_front();  // its event was lost
  return record;
}

void LawLifecycle::faulted(const wire::Event& event) {
  const std::optional<wire::LawFault> fault = record_of(event);
  Life* life = of_request(event.request_id);
  if (life == nullptr) return;
  const std::string kind(to_string(static_cast<wire::LawFaultKind>(event.code)));
  if (!fault || fault->to_law_id != fault->law_id) life->fault = kind;  // else only its parameters went back
  if (!fault) {
    life->swap.note("fault", {{"kind", kind}, {"tick", event.tick}, {"record_lost", true}});
    return keep_(life->swap, life->record);
  }
  tell_fault(*life, {{"kind", kind},
                     {"tick", fault->tick},
                     {"to_law_id", fault->to_law_id},
                     {"took_us", fault->took_ns * 1e-3},
                     {"pc", fmt::format("{:#x}", fault->pc)},
                     {"pc_offset", fault->pc_offset},
                     {"address", fmt::format("{:#x}", fault->address)}});
  if (fault->to_law_id == 0) {
    const std::string said = text_of(event.text);
    leave(*life, (said.starts_with(kind) ? said : kind) + "; no law took over: the safe law", event, 0);
  }
  locate(*life, *fault);
}

// Writes the fault into the law's certificate and into the list of recent faults. Called again when more is known.
void LawLifecycle::tell_fault(Life& life, Json fault) {
  life.swap.note("fault", fault);
  fault["law"] = life.swap.compiled().law;
  fault["request_id"] = life.swap.request_id();
  const auto known = std::find_if(told_.begin(), told_.end(), [&](const Json& each) {
    return each["request_id"] == fault["request_id"] && each["tick"] == fault["tick"];
  });
  if (known != told_.end()) {
    *known = std::move(fault);
    return;
  }
  told_.push_back(std::move(fault));
  if (told_.size() > kFaultsKept) told_.erase(told_.begin());
}

void LawLifecycle::locate(Life& life, const wire::LawFault& fault) {
  const bool is_nan = fault.kind == static_cast<std::uint32_t>(wire::LawFaultKind::not_finite);
  if (!locate_ || (fault.pc_offset == 0 && !is_nan)) return;  // not in the law's own code
  life.asked = true;
  const std::uint64_t id = life.swap.request_id();
  locate_(life.swap, fault.pc_offset, [this, id](const Json& place) {
    Life* found = of_request(id);
    if (found == nullptr) return;
    found->asked = false;
    if (place.is_object()) {
      Json known = found->swap.certificate().value("fault", Json::object());
      known.update(place);
      tell_fault(*found, std::move(known));
      keep_(found->swap, found->record);
    }
    if (found->retired) std::erase_if(lives_, [&](const Life& each) { return each.swap.request_id() == id; });
  });
}

void LawLifecycle::retired(const wire::Event& event) {
  std::erase(running_, event.code);
  Life* life = of_request(event.request_id);
  if (life == nullptr) return;
  measure(*life);
  measure_control(*life);
  if (!life->swap.mark(Stage::retired, "", event.t_ns)) return;
  keep_(life->swap, life->record);
  life->retired = true;
  std::erase_if(lives_, [](const Life& each) { return each.retired && !each.asked; });
}

// The event names the law that runs now: all laws committed after it no longer run.
void LawLifecycle::rolled_back(const wire::Event& event) {
  const auto to = std::ranges::find(running_, event.code);
  const auto first_out = to == running_.end() ? (running_.empty() ? to : running_.end() - 1) : to + 1;
  const std::string text = text_of(event.text);  // e.g. "tracking_lost: joint elbow, ..."
  for (auto each = first_out; each != running_.end(); ++each) {
    if (Life* life = of_law(*each)) {
      const bool told = !life->fault.empty() && text.starts_with(life->fault);
      leave(*life, life->fault.empty() ? "asked for" : told ? text : life->fault, event, event.code);
    }
  }
  running_.erase(first_out, running_.end());
}

void LawLifecycle::leave(Life& life, const std::string& why, const wire::Event& event, std::uint32_t runs_now) {
  if (life.swap.mark(Stage::rolled_back, why, event.t_ns)) {
    measure_control(life, why);
    const auto law = spine_.law(runs_now);
    Json told = {{"tick", event.tick},
                 {"ticks_after_commit", event.tick - std::min(event.tick, life.swap.commit_tick())},
                 {"why", why},
                 {"law", law ? Json(text_of(law->name)) : Json(nullptr)}};
    std::string next(next_step(why));
    Json seen = life.swap.certificate().value("control", Json::object()).value("seen", Json::array());
    if (seen.empty()) {                                                       // it was measured long before this
      const auto window = static_cast<std::uint64_t>(spine_.info().rate_hz);  // 1 s: it was bad for so long
      const LawControl last =
          control::measure_control(spine_, life.swap.law_id(), event.tick - std::min(event.tick, window), event.tick);
      if (last.ticks > 0) seen = explained(last, spine_.info(), why);
      if (!seen.empty()) told["seen"] = seen;
    }
    if (!seen.empty()) {  // what was measured says more than the kind of its fault
      next = seen[0];
      if (explain_) explain_(life.swap, next);
    }
    if (!next.empty()) told["next"] = next;
    life.swap.note("rolled_back", std::move(told));
    keep_(life.swap, life.record);
  }
}

Json LawLifecycle::score_of(std::uint32_t law_id) const {
  const auto life = std::ranges::find_if(lives_, [&](const Life& each) { return each.swap.law_id() == law_id; });
  if (life == lives_.end()) return nullptr;
  const Json control = life->swap.certificate().value("control", Json::object());
  Json score = {{"verdict", life->swap.verdict()}};
  if (control.empty()) return score;
  for (const char* key : {"clamped", "missed_ticks"}) score[key] = control["after"][key];
  for (const Json& joint : control["joints"]) {
    const std::string name = joint["joint"];
    if (joint["after"].is_object()) score["rms_error_rad"][name] = joint["after"]["rms_error_rad"];
    if (!joint["late_rms_error_rad"].is_null()) score["late_rms_error_rad"][name] = joint["late_rms_error_rad"];
  }
  return score;
}

std::filesystem::path LawLifecycle::page_of(std::uint32_t law_id) const {
  const auto life = std::ranges::find_if(lives_, [&](const Life& each) { return each.swap.law_id() == law_id; });
  return life == lives_.end() ? std::filesystem::path() : life->record.path;
}

std::vector<std::filesystem::path> LawLifecycle::pages() const {
  std::vector<std::filesystem::path> all;
  for (const Life& each : lives_) all.push_back(each.record.path);
  return all;
}

void LawLifecycle::end(const std::string& why, std::int64_t now_ns) {
  for (Life& each : lives_) {
    measure(each);
    measure_control(each);
    if (each.swap.mark(Stage::retired, why, now_ns)) keep_(each.swap, each.record);
  }
  lives_.clear();
  running_.clear();
}

}  // namespace lithe::control
