// SPDX-License-Identifier: Apache-2.0
// One blocking conversation with a robot's control socket.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "supervisor/core/fd.hpp"
#include "supervisor/core/lines.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

using swap::Answer;
using swap::Json;
using swap::Refusal;

// True for a verb that changes nothing: when it is not answered, nothing has happened.
bool is_question(const std::string& verb);

// Contract: one thread · blocks up to the timeout given.
class Client {
 public:
  // How a supervisor takes being asked whether it is there.
  enum class Pulse { answers, stopped, silent, gone };
  static constexpr int kQuietMs = 1500;   // so long a supervisor may say nothing
  static constexpr int kBusyMs = 10'000;  // and so long one that the machine gives no time

  // Never waits: the queue of a stopped supervisor may be full.
  static Result<Client> connect(const std::string& socket_path);
  // Somebody listens there, but has taken nobody in for long.
  static bool is_full(const Result<Client>& connected);

  // Refusal "disconnected" when the supervisor goes away, "timeout" when it does not answer in time.
  Answer call(const std::string& verb, const Json& args, int timeout_ms);

  // Asks for a sign of life and for nothing else. Stopped: its process is (Ctrl-Z, a debugger), by what the kernel
  // says. Otherwise silent after kQuietMs, or kBusyMs while it wants to run and cannot.
  Pulse pulse();
  pid_t peer_pid() const { return peer_pid_; }  // 0 = in another container

 private:
  explicit Client(Fd fd, pid_t peer_pid) : fd_(std::move(fd)), peer_pid_(peer_pid), in_(std::size_t{64} << 20) {}
  bool send_all(const std::string& text, std::int64_t deadline_ns);
  std::uint64_t send(const std::string& verb, const Json& args, std::int64_t deadline_ns);
  // Nothing before the deadline.
  std::optional<Answer> receive(std::uint64_t id, std::int64_t deadline_ns);

  Fd fd_;
  pid_t peer_pid_;
  LineBuffer in_;
  std::uint64_t next_id_ = 1;
};

// Names of the robots at whose control socket somebody listens, in alphabetical order.
std::vector<std::string> running_robots();

}  // namespace lithe::control
