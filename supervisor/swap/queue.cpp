// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/queue.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace lithe::swap {
namespace {

const char* doing(Stage reached) {
  switch (reached) {
    case Stage::submitted:
      return "compiling";
    case Stage::compiled:
    case Stage::admitted:
      return "placing";
    case Stage::placed:
      return "trying";
    case Stage::tried:
      return "loading";
    default:
      return "committing";
  }
}

// Once the Loader has the law it cannot be cancelled: it may still be committed.
Refusal too_late(const Transaction& swap, std::int64_t limit_ns) {
  const std::string what =
      fmt::format("{} '{}' took longer than {} s", doing(swap.stage()), swap.request().name, limit_ns / 1'000'000'000);
  return swap.stage() < Stage::tried
             ? Refusal{"timeout", what, "the running law is unchanged; try again, or look at the log of `lithe run`"}
             : Refusal{"timeout", "the swap is not confirmed: " + what + "; it may still take effect",
                       "see which law runs: lithe status"};
}

}  // namespace

Queue::Queue(Ports ports, std::uint64_t first_request_id, Timeouts timeouts)
    : ports_(std::move(ports)), timeouts_(timeouts), next_id_(first_request_id) {}

std::uint64_t Queue::submit(Request request, std::int64_t now_ns) {
  if (request.supersede) {
    supersede(request, now_ns);
  }
  if (waiting_.size() >= kMaxWaiting) {
    return 0;
  }
  const std::uint64_t id = next_id_++;
  waiting_.emplace_back(id, std::move(request), now_ns);
  return id;
}

// Only a waiting request is replaced: the head has already started.
void Queue::supersede(const Request& newer, std::int64_t now_ns) {
  for (std::size_t i = running_ ? 1 : 0; i < waiting_.size(); ++i) {
    const Request& older = waiting_[i].request();
    if (newer.client != 0 && older.client == newer.client && older.name == newer.name) {
      Transaction gone = std::move(waiting_[i]);
      waiting_.erase(waiting_.begin() + static_cast<std::ptrdiff_t>(i));
      gone.mark_refused({"superseded", fmt::format("a newer request for '{}' takes its place", newer.name), ""},
                        now_ns);
      ports_.finished(std::move(gone));
      return;  // at most one such request waits
    }
  }
}

Transaction* Queue::current(std::uint64_t request_id) {
  return running_ && !waiting_.empty() && waiting_.front().request_id() == request_id ? &waiting_.front() : nullptr;
}

void Queue::note(std::uint64_t request_id, const std::string& section, Json what) {
  if (Transaction* swap = current(request_id)) {
    swap->note(section, std::move(what));
  }
}

void Queue::on_compiled(std::uint64_t request_id, Compiled compiled, const std::string& admitted, std::int64_t now_ns) {
  Transaction* swap = current(request_id);
  const std::int64_t compiled_ns = now_ns - compiled.admission_ns;
  if (swap != nullptr && swap->mark_compiled(std::move(compiled), compiled_ns)) {
    swap->mark(Stage::admitted, admitted, now_ns);
    ports_.place(*swap);
  }
}

void Queue::on_placed(std::uint64_t request_id, const std::string& where, std::int64_t now_ns) {
  Transaction* swap = current(request_id);
  if (swap != nullptr && swap->mark(Stage::placed, where, now_ns)) {
    ports_.attempt(*swap);
  }
}

void Queue::on_tried(std::uint64_t request_id, const std::string& how, std::int64_t now_ns) {
  Transaction* swap = current(request_id);
  if (swap != nullptr && swap->mark(Stage::tried, how, now_ns)) {
    swap->note_missed_before(ports_.missed_releases());
    ports_.stage(*swap);
  }
}

void Queue::on_staged(std::uint64_t request_id, std::int64_t now_ns) {
  if (Transaction* swap = current(request_id)) {
    swap->mark(Stage::staged, "", now_ns);
  }
}

void Queue::on_shadow(std::uint64_t request_id, std::int64_t now_ns) {
  if (Transaction* swap = current(request_id)) {
    swap->mark(Stage::staged, "", now_ns);  // unless this was reported already
    swap->mark(Stage::shadow, "", now_ns);
  }
}

void Queue::on_committed(std::uint64_t request_id, std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns) {
  Transaction* swap = current(request_id);
  if (swap == nullptr) {
    return;
  }
  // The tick may commit before the Loader's acknowledgement is read: a committed law was staged.
  swap->mark(Stage::staged, "", now_ns);
  if (swap->mark_committed(tick, law_id, now_ns)) {
    settle();
  }
}

void Queue::on_refused(std::uint64_t request_id, Refusal reason, std::int64_t now_ns) {
  Transaction* swap = current(request_id);
  if (swap != nullptr && swap->mark_refused(std::move(reason), now_ns)) {
    settle();
  }
}

void Queue::give_up(Refusal reason, std::int64_t now_ns) {
  waiting_.front().mark_given_up(std::move(reason), now_ns);
  settle();
}

void Queue::settle() {
  Transaction swap = std::move(waiting_.front());
  waiting_.pop_front();
  running_ = false;
  swap.note_missed_after(ports_.missed_releases());
  ports_.finished(std::move(swap));
}

std::int64_t Queue::limit_ns(const Transaction& swap) const {
  switch (swap.stage()) {
    case Stage::submitted:
      return timeouts_.compile_ns;
    case Stage::compiled:
    case Stage::admitted:
      return timeouts_.place_ns;
    case Stage::placed:
      return timeouts_.trial_ns;
    case Stage::tried:
      return timeouts_.stage_ns;
    default:  // twice the time in the shadow: ticks may be lost
      return timeouts_.commit_ns + static_cast<std::int64_t>(2e9 * swap.request().terms.shadow_s);
  }
}

void Queue::step(std::int64_t now_ns) {
  if (running_) {
    Transaction& swap = waiting_.front();
    const std::int64_t limit = limit_ns(swap);
    if (now_ns - swap.stage_since_ns() > limit) {
      give_up(too_late(swap, limit), now_ns);
    }
  }
  if (!running_ && !waiting_.empty()) {
    running_ = true;
    waiting_.front().mark_started(now_ns);
    ports_.compile(waiting_.front());
  }
}

void Queue::refuse_all(const Refusal& reason, std::int64_t now_ns) {
  while (!waiting_.empty()) {
    give_up(reason, now_ns);
  }
}

}  // namespace lithe::swap
