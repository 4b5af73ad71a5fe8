// SPDX-License-Identifier: Apache-2.0
// Connection to a helper process that answers JSON lines. The process may crash; it is then started again.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>

#include "spine/core/host/fd.hpp"
#include "spine/core/result.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/core/lines.hpp"
#include "supervisor/core/process.hpp"

namespace lithe::control {

// Sends one request at a time: a request that takes too long, or crashes the service, does not affect the others.
// Contract: one thread · never blocks after start() · every ask() is answered once, also when the service dies.
class ServiceLink {
 public:
  using Callback = std::function<void(const Answer&)>;
  static constexpr std::int64_t kRestartPauseNs = 500'000'000;

  enum class Turn { next, in_line, idle };  // before all others; in order; only when no other request waits

  // `word` is the prefix of its refusal codes ("lawd": lawd_died, lawd_failed). `name` is used in messages. `starved`:
  // the code when the service got no processor time.
  ServiceLink(std::string word, std::string name, std::string starved, Launch launch)
      : word_(std::move(word)), name_(std::move(name)), starved_(std::move(starved)), launch_(std::move(launch)) {}
  ~ServiceLink() { stop(); }

  // Becomes descriptor 3 of the program and its successors; call before start(). -1 = none.
  void give(int fd) { launch_.extra_fd = fd; }
  int given() const { return launch_.extra_fd; }

  Result<> start(std::int64_t now_ns);
  // Answers with the service's own reply, without its id, or with a Refusal when there is no reply. `limit_ns` counts
  // from the moment the request is sent; after that the service is killed.
  void ask(Json request, Turn turn, std::int64_t limit_ns, Callback callback, std::int64_t now_ns);
  std::size_t idle_waiting() const { return idle_.size(); }
  // Reads answers; restarts the service when it has died. Call after poll() and at least ten times a second.
  void serve(std::int64_t now_ns);
  void stop();

  int poll_fd() const { return socket_.get(); }  // -1 while it is down
  pid_t pid() const { return process_ ? process_->pid() : 0; }
  unsigned restarts() const { return restarts_; }

 private:
  struct Job {
    std::uint64_t id;
    std::string request;
    std::int64_t limit_ns;
    Callback callback;
  };
  struct Active {
    std::uint64_t id;
    Callback callback;
    std::int64_t began_ns, deadline_ns;
    double cpu_s;  // processor time of the service when the request was sent
  };

  void read_answers();
  void write_requests(std::int64_t now_ns);
  void take(const std::string& line);
  void out_of_time(std::int64_t now_ns);
  // Refuses the request that the service was handling. By value: `why` may refer to the process that is being replaced.
  void on_death(std::string why, std::int64_t now_ns, bool starved = false);
  void refuse_waiting(const std::string& why);

  std::string word_, name_, starved_;
  Launch launch_;
  std::optional<Process> process_;
  Fd socket_;
  LineBuffer in_{std::size_t{64} << 20};
  std::string out_;
  std::deque<Job> line_;
  std::deque<Job> idle_;
  std::optional<Active> active_;  // the request that the service is handling
  std::uint64_t next_id_ = 1;
  std::int64_t restart_at_ns_ = 0;
  unsigned restarts_ = 0;
};

}  // namespace lithe::control
