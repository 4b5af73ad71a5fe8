// SPDX-License-Identifier: Apache-2.0
#include "spine/load/loader.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <ctime>

#include "spine/arena/layout.hpp"
#include "spine/core/time.hpp"

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

}  // namespace lithe::load
