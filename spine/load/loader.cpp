// SPDX-License-Identifier: Apache-2.0
#include "spine/load/loader.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <string_view>

#include "spine/arena/layout.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/time.hpp"
#include "spine/law/arithmetic.hpp"
#include "spine/law/dry_inputs.hpp"

namespace lithe::load {
namespace {

template <std::size_t N>
void copy_text(char* to, const char (&from)[N]) {
  std::memcpy(to, from, N);
  to[N - 1] = '\0';
}

// Sets the requested parameter values before any code of the law runs. A revert does not lead to the compiled values,
// with which the law was never tried. False: unknown parameter, or a value outside its range.
bool take_params(law::Resident& resident, const wire::StageRequest& request) {
  if (request.param_count > wire::kNparam) return false;
  for (std::uint32_t i = 0; i < request.param_count; ++i)
    if (!resident.set_param(request.param_index[i], request.param_value[i])) return false;
  resident.remember_params();
  return true;
}

static_assert(static_cast<std::uint32_t>(FieldKind::f64) == static_cast<std::uint32_t>(wire::StateKind::f64));
static_assert(wire::kNf == kMaxStateFields && wire::kNstate == kMaxStateBytes);

// Longest shadow, blend or probation [ticks]: ten minutes at 1 kHz.
constexpr std::uint32_t kMostTicks = 600'000;

// NaN and negative numbers count as 0. The tick limits a budget to its period.
law::Terms terms_of(const wire::StageRequest& request) {
  const auto positive = [](double value) { return value > 0 && std::isfinite(value) ? value : 0.0; };
  return {request.budget_ns,
          std::min(request.shadow_ticks, kMostTicks),
          std::min(request.blend_ticks, kMostTicks),
          std::min(request.probation_ticks, kMostTicks),
          positive(request.shadow_tolerance_nm),
          positive(request.probation_error_ratio),
          request.shadow_only != 0};
}

constexpr std::int64_t kMostNs = 20'000'000;  // limit of one call, on a core that is shared

struct Start {
  decltype(LitheLaw::init) init;
  const History* history;
  law::Sandbox* sandbox;
};

void call_init(void* context) {
  const Start& start = *static_cast<const Start*>(context);
  law::with_law_arithmetic(
      [&start]() LITHE_RT { start.init(start.history, start.sandbox->params.data(), start.sandbox->state.data()); });
}

void call_step(void* context) { static_cast<law::Sandbox*>(context)->call(); }

void copy(const wire::Telemetry& record, std::int64_t now_ns, std::uint32_t joints, PastTick& tick) {
  tick.age_s = static_cast<double>(now_ns - record.release_ns) * 1e-9;
  copy_joints(record.position_rad, tick.position_rad, joints);
  copy_joints(record.velocity_rad_s, tick.velocity_rad_s, joints);
  copy_joints(record.torque_nm, tick.torque_nm, joints);
  copy_joints(record.setpoint_position_rad, tick.setpoint_position_rad, joints);
  copy_joints(record.setpoint_velocity_rad_s, tick.setpoint_velocity_rad_s, joints);
  copy_joints(record.command_torque_nm, tick.command_torque_nm, joints);
  tick.sensor = record.sensor;
}

}  // namespace

Loader::Loader(law::Slot& slot, LawStore& store, ipc::SpineMemory& spine, const ipc::ControlMemory& control,
               Rehearsal& rehearsal, LawStore* arena)
    : slot_(slot),
      store_(store),
      arena_(arena),
      spine_(spine),
      requests_(control.stage, spine.stage_ack),
      events_(spine.events_loader),
      rehearsal_(rehearsal) {
  for (std::uint32_t i = 0; i < residents_.size(); ++i) residents_[i].index = i;
}

void Loader::run(const std::atomic<bool>& stop) {
  const timespec pause{0, 1'000'000};
  while (!stop.load(std::memory_order_relaxed))  // relaxed: only the stop flag is passed
    if (!poll(monotonic_ns())) nanosleep(&pause, nullptr);
}

bool Loader::poll(std::int64_t now_ns) {
  if (retire_one(now_ns)) return true;
  if (candidate_waits(now_ns)) return false;  // the next request waits in the mailbox
  std::uint64_t ticket = 0;
  if (!requests_.receive(request_, ticket)) {
    std::uint64_t& told = spine_.health.stage_violations;
    if (told != requests_.violations()) ipc::store_word(told, requests_.violations(), std::memory_order_relaxed);
    return false;
  }
  requests_.answer(ticket, static_cast<std::uint32_t>(stage(request_, now_ns)));
  return true;
}

// One at a time: with dlopen each one needs a dlclose.
bool Loader::retire_one(std::int64_t now_ns) {
  law::Resident* gone = slot_.collect_retired();
  if (gone == nullptr) return false;
  if (gone == waiting_) waiting_ = nullptr;  // it was committed and rolled back between two polls
  tell(wire::EventKind::law_retired, gone->request_id, gone->law_id, 0, gone->descriptor->name, now_ns);
  release(*gone);
  return true;
}

// State migration is planned against the active law, so the next request must wait until this candidate is committed. A
// candidate that no tick commits is withdrawn.
bool Loader::candidate_waits(std::int64_t now_ns) {
  if (waiting_ == nullptr) return false;
  if (slot_.active_id() == waiting_->law_id) {
    waiting_ = nullptr;
    return false;
  }
  if (now_ns - offered_ns_ < kCommitTimeoutNs) return true;
  law::Resident* back = slot_.withdraw();
  if (back == nullptr) return true;  // the tick has just taken it; its id follows soon
  waiting_ = nullptr;
  tell(wire::EventKind::law_refused, back->request_id, static_cast<std::uint32_t>(wire::StageResult::busy), 0,
       "no tick committed the law: is the Spine ticking?", now_ns);
  release(*back);
  return false;
}

wire::StageResult Loader::stage(const wire::StageRequest& request, std::int64_t now_ns) {
  Text why{};
  law::Resident* resident = free_resident();
  wire::StageResult result = wire::StageResult::slots_full;
  if (waiting_ != nullptr) {
    result = wire::StageResult::busy;
    std::snprintf(why.data(), why.size(), "another law is waiting for its tick");
  } else if (resident == nullptr) {
    std::snprintf(why.data(), why.size(), "all %u laws that fit are loaded", law::kResidents);
  } else {
    result = prepare(*resident, request, why);
  }
  if (result != wire::StageResult::staged) {
    tell(wire::EventKind::law_refused, request.request_id, static_cast<std::uint32_t>(result), 0, why.data(), now_ns);
    return result;
  }
  const std::int64_t staged_ns = monotonic_ns();
  const double load_ms = static_cast<double>(staged_ns - now_ns) * 1e-6;
  publish_info(*resident);
  tell(wire::EventKind::law_staged, request.request_id, resident->law_id, load_ms, resident->descriptor->name,
       staged_ns);
  waiting_ = resident;
  offered_ns_ = now_ns;
  slot_.offer(resident);  // cannot fail: there is no other candidate
  return result;
}

law::Resident* Loader::free_resident() {
  for (std::uint32_t i = 0; i < residents_.size(); ++i)
    if (!used_[i]) return &residents_[i];
  return nullptr;
}

wire::StageResult Loader::prepare(law::Resident& resident, const wire::StageRequest& request, Text& why) {
  if (request.slot != 0 && arena_ == nullptr) {
    std::snprintf(why.data(), why.size(), "this Spine has no code arena: it loads laws with dlopen");
    return wire::StageResult::load_failed;
  }
  const LitheLaw* law = nullptr;
  LawStore& store = request.slot != 0 ? *arena_ : store_;
  const wire::StageResult loaded = store.load(resident.index, request, law, why);
  if (loaded != wire::StageResult::staged) return loaded;
  resident.slot = request.slot;
  if (*law::describe_mismatch(*law, why.data(), why.size()) != '\0') {
    unload(resident);
    return wire::StageResult::abi_mismatch;
  }
  law::reset_resident(resident, *law);
  resident.slot = request.slot;
  resident.code_bytes = request.slot != 0 ? request.code_bytes : 0;
  resident.code_address = request.slot != 0 ? arena::slot_address(request.slot) : 0;
  resident.request_id = request.request_id;
  resident.source_hash = request.source_hash;
  resident.terms = terms_of(request);
  if (!take_params(resident, request)) {
    std::snprintf(why.data(), why.size(), "a parameter of the request is not the law's, or outside its range");
    unload(resident);
    return wire::StageResult::hostile;
  }
  if (!rehearsal_.prepare(resident, monotonic_ns(), why)) {
    unload(resident);
    return wire::StageResult::dry_run_failed;
  }
  resident.law_id = next_id_++;
  used_[resident.index] = true;
  plan_all_migrations(resident);
  return wire::StageResult::staged;
}

// Plans the migration from every law in memory: after a rollback any of them may be active at the commit.
void Loader::plan_all_migrations(law::Resident& candidate) {
  for (const law::Resident& peer : residents_)
    if (used_[peer.index] && &peer != &candidate) law::plan_migrations(candidate, peer);
}

void Loader::unload(const law::Resident& resident) { (resident.slot != 0 ? *arena_ : store_).unload(resident.index); }

void Loader::release(law::Resident& resident) {
  unload(resident);
  used_[resident.index] = false;
  resident.law_id = 0;
  resident.descriptor = nullptr;
  publish_info(resident);
}

void Loader::publish_info(const law::Resident& resident) {
  info_ = {};
  if (resident.descriptor != nullptr) {
    const LitheLaw& law = *resident.descriptor;
    info_.law_id = resident.law_id;
    info_.param_count = law.param_count;
    info_.probe_count = law.probe_count;
    info_.state_bytes = law.state_size;
    info_.source_hash = resident.source_hash;
    info_.request_id = resident.request_id;
    info_.slot = resident.slot;
    info_.code_bytes = resident.code_bytes;
    copy_text(info_.name.data(), law.name);
    for (std::uint32_t i = 0; i < law.param_count; ++i) {
      copy_text(info_.param_name.data() + 32 * i, law.params[i].name);
      info_.param_value[i] = law.params[i].value;
      info_.param_min[i] = law.params[i].min;
      info_.param_max[i] = law.params[i].max;
    }
    for (std::uint32_t i = 0; i < law.probe_count; ++i) copy_text(info_.probe_name.data() + 32 * i, law.probes[i]);
    info_.state_field_count = law.state_count;
    for (std::uint32_t i = 0; i < law.state_count; ++i) {
      copy_text(info_.state_name.data() + 32 * i, law.state[i].name);
      info_.state_kind[i] = law.state[i].kind;
      info_.state_offset[i] = law.state[i].offset;
      info_.state_elements[i] = law.state[i].count;
    }
  }
  ipc::ChannelWriter<wire::LawInfo>(spine_.law_info[resident.index]).write(info_);
}

void Loader::tell(wire::EventKind kind, std::uint64_t request_id, std::uint32_t code, double value, const char* text,
                  std::int64_t now_ns) {
  wire::Event event;
  event.t_ns = now_ns;
  event.request_id = request_id;
  event.kind = static_cast<std::uint32_t>(kind);
  event.code = code;
  event.value = value;
  std::snprintf(event.text.data(), event.text.size(), "%s", text);
  events_.push(event);
}

bool is_finite(const wire::Telemetry& record, std::uint32_t joints) {
  return all_finite(record.position_rad, joints) && all_finite(record.velocity_rad_s, joints) &&
         all_finite(record.torque_nm, joints) && all_finite(record.setpoint_position_rad, joints) &&
         all_finite(record.setpoint_velocity_rad_s, joints) && all_finite(record.command_torque_nm, joints);
}

Rehearsal::Rehearsal(const ipc::SpineMemory& spine, std::uint32_t joints, double dt_s, law::Sandbox& sandbox)
    : spine_(spine),
      joints_(joints),
      dt_s_(dt_s),
      sandbox_(sandbox),
      past_(std::make_unique<std::array<PastTick, kMostPast>>()) {}

bool Rehearsal::prepare(law::Resident& law, std::int64_t now_ns, std::span<char> why) {
  return start(law, now_ns, why) && dry_steps(law, why);
}

bool Rehearsal::start(law::Resident& law, std::int64_t now_ns, std::span<char> why) {
  if (law.descriptor->init == nullptr) return true;
  Tick tick;
  tick.joints = joints_;
  sandbox_.enter(law, tick);
  Start start{law.descriptor->init, &look_back(now_ns), &sandbox_};
  if (!contained(&call_init, &start, "init", why)) return false;
  sandbox_.keep_state(law);
  return true;
}

// The newest first. Left out: records that are overwritten during the read, and those with a NaN of a broken sensor.
const History& Rehearsal::look_back(std::int64_t now_ns) {
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> reader(spine_.telemetry);
  reader.rewind(kMostPast);  // more records may arrive during the read
  std::uint32_t seen = 0;
  while (!reader.empty()) {
    if (!reader.next(record_) || !is_finite(record_, joints_)) continue;
    copy(record_, now_ns, joints_, (*past_)[seen++ % kMostPast]);
  }
  const std::uint32_t count = std::min(seen, kMostPast);
  if (seen > kMostPast) std::rotate(past_->begin(), past_->begin() + seen % kMostPast, past_->end());
  std::reverse(past_->begin(), past_->begin() + count);
  history_ = {past_->data(), count, joints_, dt_s_};
  return history_;
}

bool Rehearsal::dry_steps(const law::Resident& law, std::span<char> why) {
  scratch_ = law;
  Tick tick;
  for (std::uint64_t k = 0; k < 2 * law::kDryStepsAtRest; ++k) {
    law::dry_input(tick, k, joints_);
    sandbox_.enter(scratch_, tick);
    if (!contained(&call_step, &sandbox_, "step", why)) return false;
    sandbox_.keep_state(scratch_);
    char bad[64];
    if (law::outputs_are_finite(sandbox_.effort, sandbox_.probes, *law.descriptor, joints_, bad, sizeof bad)) continue;
    std::snprintf(why.data(), why.size(), "%s is not finite in dry step %u", bad, static_cast<unsigned>(k));
    return false;
  }
  return true;
}

bool Rehearsal::contained(contain::FaultBarrier::Call call, void* context, const char* what, std::span<char> why) {
  if (barrier_ == nullptr) {
    call(context);
    return true;
  }
  const contain::Failure failure = barrier_->run(monotonic_ns() + kMostNs, call, context);
  if (!failure) return true;
  const std::string_view kind = wire::to_string(failure.kind);
  std::snprintf(why.data(), why.size(), "%s failed before its first tick: %.*s", what, static_cast<int>(kind.size()),
                kind.data());
  return false;
}

}  // namespace lithe::load
