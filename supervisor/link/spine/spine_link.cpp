// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/spine/spine_link.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <iterator>

#include "spine/arena/arena.hpp"
#include "spine/core/histogram.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/frames.hpp"
#include "supervisor/core/process.hpp"

namespace lithe::control {

using Spine = ipc::Segment<ipc::SpineMemory>;
using Control = ipc::Segment<ipc::ControlMemory>;

namespace {

constexpr std::int64_t kMostDyingNs = 5 * kNsPerS;

// A killed process keeps its lease until its last thread has ended.
bool is_dying(pid_t pid) {
  const char state = state_of(pid);
  return state == 'Z' || state == 'X';
}

}  // namespace

std::optional<pid_t> spine_now(const std::string& robot) {
  if (!ipc::Lease::is_held(Spine::path(robot))) return std::nullopt;
  // Read as bytes: a Spine of another build has another layout, but the same header.
  wire::SegmentHeader header{};
  const auto file = open_regular(AT_FDCWD, Spine::path(robot), O_RDONLY);
  const bool known =
      file && ::read(file->get(), &header, sizeof header) == sizeof header && header.magic == wire::kMagic;
  return known ? static_cast<pid_t>(header.writer_pid) : 0;
}

std::optional<pid_t> live_spine(const std::string& robot) {
  const std::int64_t until_ns = monotonic_ns() + kMostDyingNs;
  std::optional<pid_t> pid = spine_now(robot);
  while (pid && *pid > 0 && is_dying(*pid) && monotonic_ns() < until_ns) {
    ::usleep(10'000);
    pid = spine_now(robot);
  }
  return pid;
}

pid_t noted_supervisor(const std::string& robot) {
  constexpr std::size_t kMostDigits = 32;
  const auto text = read_regular_file(fmt::format("{}/{}.pid", run_dir(), robot), kMostDigits);
  if (const pid_t pid = text ? std::atoi(text->c_str()) : 0; pid > 0) return pid;
  const auto control = Control::attach(robot, ipc::Access::read);
  return control ? static_cast<pid_t>((*control)->header.writer_pid) : 0;
}

Fd open_arena(const robot::RobotConfig& robot) {
  if (robot.spine.loader == robot::LawLoader::dlopen) return Fd();
  const pid_t pid = live_spine(robot.name).value_or(0);
  const Result<int> memory = pid != 0 ? arena::memory_of(pid) : arena::make_memory();
  if (!memory) {
    spdlog::warn("{}; laws are loaded with dlopen", memory.message());
    return Fd();
  }
  return Fd(*memory);
}

bool remove_segments(const std::string& robot) {
  const auto lease = ipc::Lease::try_take(Spine::path(robot));
  if (!lease || !*lease) return false;
  for (const std::string& path : {Spine::path(robot), Control::path(robot), ipc::Segment<ipc::BrainMemory>::path(robot),
                                  ipc::Segment<ipc::FramesMemory>::path(robot)}) {
    ipc::remove_segment(path);
  }
  return true;
}

Result<> press_estop(const std::string& robot) {
  const Result<Control> control = Control::attach(robot, ipc::Access::write);
  if (!control) return control.error();
  // release: partner of the tick's acquire load; the word is sticky, so a second writer can only press it too.
  ipc::store_word((*control)->estop.value, 1, std::memory_order_release);
  return done();
}

Result<SpineLink> SpineLink::attach(const std::string& robot) {
  Result<Spine> spine = Spine::attach(robot, ipc::Access::read);
  if (!spine) return spine.error();
  Result<Control> control = Control::attach(robot, ipc::Access::write);
  if (!control) return control.error();
  ipc::sign_in((*control)->header, monotonic_ns());
  SpineLink link(std::move(*spine), std::move(*control));
  if (!ipc::ChannelReader<wire::RobotInfo>(link.spine_->robot_info).read(link.info_))
    return Error{fmt::format("the Spine of '{}' has not published what it runs; is it still starting?", robot)};
  return link;
}

SpineLink::SpineLink(Spine spine, Control control)
    : spine_(std::move(spine)),
      control_(std::move(control)),
      telemetry_(spine_->telemetry),
      events_tick_(spine_->events_tick),
      events_loader_(spine_->events_loader),
      commands_(control_->commands, spine_->control_ack),
      stage_(control_->stage, spine_->stage_ack),
      inherited_(stage_.last_ticket()) {
  events_tick_.rewind();
  events_loader_.rewind();
}

pid_t SpineLink::spine_pid() const {
  return static_cast<pid_t>(ipc::load_word(spine_->header.writer_pid, std::memory_order_relaxed));
}

wire::Telemetry SpineLink::now() const {
  wire::Telemetry record{};
  (void)latest(record);
  return record;
}

std::vector<wire::LawInfo> SpineLink::laws() const {
  std::vector<wire::LawInfo> found;
  for (const auto& channel : spine_->law_info) {
    wire::LawInfo info;
    if (ipc::ChannelReader<wire::LawInfo>(channel).read(info) && info.law_id != 0) {
      info.param_count = std::min<std::uint32_t>(info.param_count, wire::kNparam);
      found.push_back(info);
    }
  }
  std::ranges::sort(found, [](const auto& a, const auto& b) { return a.law_id < b.law_id; });
  return found;
}

std::optional<wire::LawInfo> SpineLink::law(std::uint32_t law_id) const {
  for (const wire::LawInfo& info : laws())
    if (info.law_id == law_id) return info;
  return std::nullopt;
}

std::optional<wire::Params> SpineLink::params() const {
  wire::Params params;
  if (!ipc::ChannelReader<wire::Params>(spine_->params).read(params)) return std::nullopt;
  return params;
}

std::optional<RunningLaw> SpineLink::running_law() const {
  wire::Telemetry now{};
  const auto info = latest(now) ? law(now.law_id) : std::nullopt;
  if (!info) return std::nullopt;
  RunningLaw running{*info};
  const auto live = params();
  for (std::uint32_t i = 0; i < info->param_count; ++i) {
    const bool is_live = live && live->law_id == info->law_id && i < live->count;
    running.values[name_at(info->param_name, i)] = is_live ? live->value[i] : info->param_value[i];
  }
  return running;
}

std::int64_t SpineLink::brain_heartbeat_ns() const {
  const auto brain = ipc::Segment<ipc::BrainMemory>::attach(text_of(info_.robot), ipc::Access::read);
  if (!brain) return 0;
  // acquire, with the release store of the Brain
  return std::atomic_ref<std::int64_t>((*brain)->header.heartbeat_ns).load(std::memory_order_acquire);
}

Quantiles SpineLink::quantiles(const ipc::HistogramMemory& histogram) const {
  std::array<std::uint64_t, wire::kNbin> bins;
  for (std::size_t i = 0; i < bins.size(); ++i) bins[i] = ipc::load_word(histogram.bin[i], std::memory_order_relaxed);
  const double max_us = static_cast<double>(ipc::load_word(histogram.max_ns, std::memory_order_relaxed)) * 1e-3;
  const auto at = [&](double q) {
    return std::min(static_cast<double>(histogram_quantile_ns(bins, q)) * 1e-3, max_us);
  };
  return {at(0.5), at(0.99), at(0.999), max_us, ipc::load_word(histogram.count, std::memory_order_relaxed)};
}

std::optional<bool> SpineLink::confirmed_off() const {
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events(spine_->events_tick);
  events.rewind(1);
  wire::Event last{};
  if (!events.next(last) || last.kind != static_cast<std::uint32_t>(wire::EventKind::disarmed) || last.code == 0)
    return std::nullopt;
  return last.code == 1;
}

std::vector<wire::Event> SpineLink::drain_events() {
  const auto drain = [](auto& ring, std::size_t depth) {
    std::vector<wire::Event> events;
    wire::Event event;
    // Test empty(), not next(): next() is false also for a record that was overwritten while it was read, and more
    // records may follow.
    for (std::size_t i = 0; i < depth && !ring.empty(); ++i)
      if (ring.next(event)) events.push_back(event);
    return events;
  };
  // Read the Loader's ring first. The Loader retires a law after the tick's event about it, so the reason is always
  // read before, or together with, the retirement.
  const std::vector<wire::Event> loader = drain(events_loader_, wire::spine_segment::kEventsLoaderDepth);
  const std::vector<wire::Event> tick = drain(events_tick_, wire::spine_segment::kEventsTickDepth);
  std::vector<wire::Event> merged;
  std::merge(loader.begin(), loader.end(), tick.begin(), tick.end(), std::back_inserter(merged),
             [](const wire::Event& a, const wire::Event& b) { return a.t_ns < b.t_ns; });
  return merged;
}

std::optional<std::uint64_t> SpineLink::stage(const wire::StageRequest& request) {
  const auto ticket = stage_.send(request);
  if (ticket && arena::is_slot(request.slot)) slots_[request.slot] = {Slot::asked, *ticket};
  return ticket;
}

bool SpineLink::has_arena() const {
  return info_.arena_base == arena::kBase && info_.arena_slots == arena::kSlots &&
         info_.arena_slot_bytes == arena::kSlotBytes;
}

// A stage request that waits in the mailbox, or that the Loader is handling, names a slot that no LawInfo shows yet
// (models/placement.pml).
bool SpineLink::predecessors_requests_are_answered() {
  constexpr std::uint64_t kDepth = wire::control_segment::kStageDepth;
  for (std::uint64_t ticket = inherited_ > kDepth ? inherited_ - kDepth + 1 : 1; ticket <= inherited_; ++ticket)
    if (poll_stage(ticket) == wire::StageResult::pending) return false;
  inherited_ = 0;
  return true;
}

std::uint32_t SpineLink::take_slot() {
  if (!predecessors_requests_are_answered()) return 0;
  // Read the answers first: the Loader publishes a law before it answers the request.
  for (Slot& slot : slots_)
    if (slot.state == Slot::asked && poll_stage(slot.ticket) != wire::StageResult::pending) slot = {};
  std::array<bool, arena::kSlots + 1> resident{};
  for (const wire::LawInfo& law : laws())
    if (arena::is_slot(law.slot)) resident[law.slot] = true;
  for (std::uint32_t i = 0; i < arena::kSlots; ++i) {
    const std::uint32_t slot = 1 + (last_slot_ + i) % arena::kSlots;
    if (resident[slot] || slots_[slot].state != Slot::free) continue;
    slots_[slot].state = Slot::taken;
    return last_slot_ = slot;
  }
  return 0;
}

void SpineLink::heartbeat(std::int64_t now_ns) {
  std::atomic_ref<std::int64_t>(control_->header.heartbeat_ns).store(now_ns, std::memory_order_release);
}

void SpineLink::press_estop() { ipc::store_word(control_->estop.value, 1, std::memory_order_release); }

std::string SpineLink::estop_holder() const {
  const std::string robot = text_of(info_.robot);
  const auto brain = ipc::Segment<ipc::BrainMemory>::attach(robot, ipc::Access::read);
  if (!brain || ipc::load_word((*brain)->estop.value, std::memory_order_relaxed) == 0) return "";
  if (!ipc::Lease::is_held(ipc::Segment<ipc::BrainMemory>::path(robot))) return "";  // it died: reset clears its word
  const auto pid = static_cast<pid_t>(ipc::load_word((*brain)->header.writer_pid, std::memory_order_relaxed));
  const std::string command = command_of(pid);
  return fmt::format("pid {}{}", pid, command.empty() ? "" : fmt::format(" ({})", command));
}

void SpineLink::release_estop() {
  ipc::store_word(control_->estop.value, 0, std::memory_order_release);
  // A Brain that died with its e-stop word set cannot clear it. Its lease is free then, so we clear it.
  using Brain = ipc::Segment<ipc::BrainMemory>;
  const std::string robot = text_of(info_.robot);
  const auto lease = ipc::Lease::try_take(Brain::path(robot));
  if (lease && *lease) {
    if (const auto brain = Brain::attach(robot, ipc::Access::write))
      ipc::store_word((*brain)->estop.value, 0, std::memory_order_release);
  }
}

}  // namespace lithe::control
