// SPDX-License-Identifier: Apache-2.0
// A blocking client of a robot's control socket.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <variant>
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

// Finds the live processes of a robot: a Spine that ticks, a supervisor that answers. Read-only for both.

struct Presence {
  enum class Supervisor { none, starting, answers, stopped, silent };
  std::string robot;
  Supervisor supervisor = Supervisor::none;
  pid_t supervisor_pid = 0;                  // 0 = unknown
  std::optional<pid_t> spine_pid;            // nothing: no Spine lives; 0 = unknown
  bool ticks = false;                        // the tick counter moved during the check
  std::string mode = "-", fault = "-", law;  // of its last tick
  std::uint64_t tick = 0;
  std::string unreadable;  // why the Spine's state cannot be read: another build, no permission
  std::string config;      // path of its robot file; empty = unknown

  bool is_there() const { return supervisor != Supervisor::none || spine_pid.has_value(); }
};

const char* word(Presence::Supervisor supervisor);

// Takes up to 2 s when a supervisor does not answer, and longer when it gets no processor time.
Presence look_for(const std::string& robot);

// A connection to a supervisor that answers; otherwise a Refusal with the reason and the next step.
std::variant<Client, Refusal> reach(const std::string& robot);

// True for the codes of reach(): the request was not delivered.
bool is_unreachable(const Refusal& refusal);

Json presence_json(const Presence& presence);

// Robots that have a control segment, alive or not.
std::set<std::string> robots_with_memory();
// These, and robots that have a socket or a pid file in run_dir(): a robot that starts has no memory yet.
std::set<std::string> known_robots();

}  // namespace lithe::control
