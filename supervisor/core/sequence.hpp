// SPDX-License-Identifier: Apache-2.0
// Steps that take many turns of the event loop, written from top to bottom as one coroutine.
#pragma once

#include <coroutine>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <utility>
#include <variant>

#include "supervisor/core/answer.hpp"

namespace lithe::control {

// Contract: one thread · never blocks · runs only inside serve(); a serve() from inside the sequence does nothing ·
// may be destroyed while it waits
class Sequence {
 public:
  struct promise_type;

  // `co_await` waits until `ready`, which is asked at once and in every serve(). It returns nothing then, else why not:
  // `late` after the deadline, or the reason of abort().
  class Until {
   public:
    using Ready = std::function<bool(std::int64_t now_ns)>;

    Until(Ready ready, std::int64_t deadline_ns, Refusal late)
        : ready_(std::move(ready)), deadline_ns_(deadline_ns), late_(std::move(late)) {}

    bool await_ready() const noexcept { return false; }
    bool await_suspend(std::coroutine_handle<promise_type> self);
    std::optional<Refusal> await_resume() { return std::move(why_not_); }

   private:
    friend class Sequence;
    bool over(const promise_type& now);

    Ready ready_;
    std::int64_t deadline_ns_;
    Refusal late_;
    std::optional<Refusal> why_not_;
  };

  // `co_await` waits until somebody has put an answer into `pending`. It returns that answer, or why there is none.
  template <class T>
  class Reply : public Until {
   public:
    using Outcome = std::variant<T, Refusal>;
    using Pending = std::shared_ptr<std::optional<Outcome>>;

    Reply(Pending pending, std::int64_t deadline_ns, Refusal late)
        : Until([pending](std::int64_t) { return pending->has_value(); }, deadline_ns, std::move(late)),
          pending_(std::move(pending)) {}

    Outcome await_resume() {
      if (auto why_not = Until::await_resume()) return std::move(*why_not);
      return std::move(**pending_);
    }

   private:
    Pending pending_;
  };

  explicit Sequence(std::coroutine_handle<promise_type> self) : self_(self) {}
  Sequence(Sequence&& other) noexcept : self_(std::exchange(other.self_, nullptr)) {}
  Sequence(const Sequence&) = delete;
  Sequence& operator=(const Sequence&) = delete;
  Sequence& operator=(Sequence&&) = delete;
  ~Sequence() {
    if (self_) self_.destroy();
  }

  // Goes on when what it waits for has come, or its time is up. The first call starts it.
  void serve(std::int64_t now_ns);
  // Ends its present wait, and every later one that is not ready at once.
  void abort(Refusal reason, std::int64_t now_ns);
  bool done() const;
  // The time of the serve() that runs.
  std::int64_t now_ns() const;

 private:
  std::coroutine_handle<promise_type> self_;
};

struct Sequence::promise_type {
  enum class State { waits, runs, done } state = State::waits;
  Until* until = nullptr;  // in the coroutine's frame; nullptr before the first wait
  std::int64_t now_ns = 0;
  std::optional<Refusal> aborted;

  Sequence get_return_object() { return Sequence(std::coroutine_handle<promise_type>::from_promise(*this)); }
  std::suspend_always initial_suspend() noexcept { return {}; }
  std::suspend_always final_suspend() noexcept { return {}; }
  void return_void() { state = State::done; }
  void unhandled_exception() {
    state = State::done;
    throw;  // out of serve()
  }
};

inline bool Sequence::Until::over(const promise_type& now) {
  if (!ready_(now.now_ns)) {
    why_not_ = now.aborted ? now.aborted : now.now_ns > deadline_ns_ ? std::optional(late_) : std::nullopt;
    return why_not_.has_value();
  }
  return true;
}

inline bool Sequence::Until::await_suspend(std::coroutine_handle<promise_type> self) {
  if (over(self.promise())) return false;
  self.promise().until = this;
  self.promise().state = promise_type::State::waits;
  return true;
}

inline void Sequence::serve(std::int64_t now_ns) {
  promise_type& promise = self_.promise();
  if (promise.state != promise_type::State::waits) return;
  promise.now_ns = now_ns;
  if (promise.until == nullptr || promise.until->over(promise)) {
    promise.state = promise_type::State::runs;
    self_.resume();
  }
}

inline void Sequence::abort(Refusal reason, std::int64_t now_ns) {
  self_.promise().aborted = std::move(reason);
  serve(now_ns);
}

inline bool Sequence::done() const { return self_.promise().state == promise_type::State::done; }

inline std::int64_t Sequence::now_ns() const { return self_.promise().now_ns; }

}  // namespace lithe::control
