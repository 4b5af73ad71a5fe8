// SPDX-License-Identifier: Apache-2.0
// A blocking client of a robot's control socket.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/host/fd.hpp"
#include "spine/core/result.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/core/lines.hpp"

namespace lithe::control {

// True for a verb that only reads: without an answer, nothing has changed.
bool is_question(const std::string& verb);

// Contract: one thread · blocks up to the timeout given.
class Client {
 public:
  // Result of the check whether a supervisor responds.
  enum class Pulse { answers, stopped, silent, gone };
  static constexpr int kQuietMs = 1500;   // a supervisor without an answer for this long counts as silent
  static constexpr int kBusyMs = 10'000;  // the same for one that is ready to run but gets no processor time

  // Never waits: the accept queue of a stopped supervisor may be full.
  static Result<Client> connect(const std::string& socket_path);
  // A process listens there, but has not accepted a connection for a long time.
  static bool is_full(const Result<Client>& connected);

  // Refusal "disconnected" when the supervisor goes away, "timeout" when it does not answer in time.
  Answer call(const std::string& verb, const Json& args, int timeout_ms);

  // Sends `ping` and nothing else. `stopped`: the kernel reports the process as stopped (Ctrl-Z, a debugger). `silent`:
  // no answer within kQuietMs, or within kBusyMs while the process is ready to run but gets no processor time.
  Pulse pulse();
  pid_t peer_pid() const { return peer_pid_; }  // 0 = not visible, for example in another container

 private:
  explicit Client(Fd fd, pid_t peer_pid) : fd_(std::move(fd)), peer_pid_(peer_pid), in_(std::size_t{64} << 20) {}
  bool send_all(const std::string& text, std::int64_t deadline_ns);
  std::uint64_t send(const std::string& verb, const Json& args, std::int64_t deadline_ns);
  // Empty when no line arrives before the deadline.
  std::optional<Answer> receive(std::uint64_t id, std::int64_t deadline_ns);

  Fd fd_;
  pid_t peer_pid_;
  LineBuffer in_;
  std::uint64_t next_id_ = 1;
};

// Names of the robots whose control socket has a listening process, in alphabetical order.
std::vector<std::string> running_robots();

}  // namespace lithe::control
