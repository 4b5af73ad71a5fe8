// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/queue.hpp"

#include <fmt/format.h>

#include <utility>

namespace lithe::swap {
namespace {

// Once the Loader has the law, nobody here can call it back: it may still be committed.
Refusal too_late(const Transaction& swap, std::int64_t limit_ns) {
  const bool compiling = swap.stage() == Stage::submitted;
  const char* step = compiling ? "compiling" : swap.stage() == Stage::compiled ? "loading" : "committing";
  const std::string what =
      fmt::format("{} '{}' took longer than {} s", step, swap.request().name, limit_ns / 1'000'000'000);
  return compiling
             ? Refusal{"timeout", what, "the running law is unchanged; try again, or look at the log of `lithe run`"}
             : Refusal{"timeout", "the swap is not confirmed: " + what + "; it may still take effect",
                       "see which law runs: lithe status"};
}

}  // namespace

Queue::Queue(Ports ports, std::uint64_t first_request_id, Timeouts timeouts)
    : ports_(std::move(ports)), timeouts_(timeouts), next_id_(first_request_id) {}

std::uint64_t Queue::submit(Request request, std::int64_t now_ns) {
  if (waiting_.size() >= kMaxWaiting) {
    return 0;
  }
  const std::uint64_t id = next_id_++;
  waiting_.emplace_back(id, std::move(request), now_ns);
  return id;
}

Transaction* Queue::current(std::uint64_t request_id) {
  return running_ && !waiting_.empty() && waiting_.front().request_id() == request_id ? &waiting_.front() : nullptr;
}

void Queue::on_compiled(std::uint64_t request_id, Compiled compiled, std::int64_t now_ns) {
  Transaction* swap = current(request_id);
  if (swap != nullptr && swap->mark_compiled(std::move(compiled), now_ns)) {
    swap->note_missed_before(ports_.missed_releases());
    ports_.stage(*swap);
  }
}

void Queue::on_staged(std::uint64_t request_id, std::int64_t now_ns) {
  if (Transaction* swap = current(request_id)) {
    swap->mark_staged(now_ns);
  }
}

void Queue::on_committed(std::uint64_t request_id, std::uint64_t tick, std::uint32_t law_id, std::int64_t now_ns) {
  Transaction* swap = current(request_id);
  if (swap == nullptr) {
    return;
  }
  // The tick may commit before the Loader's acknowledgement is read: a committed law was staged.
  if (swap->stage() == Stage::compiled) {
    swap->mark_staged(now_ns);
  }
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

void Queue::settle() {
  Transaction swap = std::move(waiting_.front());
  waiting_.pop_front();
  running_ = false;
  swap.note_missed_after(ports_.missed_releases());
  ports_.finished(swap);
}

void Queue::step(std::int64_t now_ns) {
  if (running_) {
    Transaction& swap = waiting_.front();
    const bool compiling = swap.stage() == Stage::submitted;
    const bool staging = swap.stage() == Stage::compiled;
    const std::int64_t limit_ns = compiling ? timeouts_.compile_ns : staging ? timeouts_.stage_ns : timeouts_.commit_ns;
    if (now_ns - swap.stage_since_ns() > limit_ns) {
      on_refused(swap.request_id(), too_late(swap, limit_ns), now_ns);
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
    waiting_.front().mark_refused(reason, now_ns);
    settle();
  }
}

}  // namespace lithe::swap
