// SPDX-License-Identifier: Apache-2.0
// One blocking conversation with a robot's control socket.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "supervisor/control/fd.hpp"
#include "supervisor/control/lines.hpp"
#include "supervisor/swap/answer.hpp"

namespace lithe::control {

using swap::Answer;
using swap::Json;
using swap::Refusal;

// Contract: one thread · blocks up to the timeout given.
class Client {
 public:
  static Result<Client> connect(const std::string& socket_path);

  // Refusal "disconnected" when the supervisor goes away, "timeout" when it does not answer in time.
  Answer call(const std::string& verb, const Json& args, int timeout_ms);

 private:
  explicit Client(Fd fd) : fd_(std::move(fd)), in_(std::size_t{64} << 20) {}
  bool send_all(const std::string& text, std::int64_t deadline_ns);

  Fd fd_;
  LineBuffer in_;
  std::uint64_t next_id_ = 1;
};

// Names of the robots whose control socket answers, in alphabetical order.
std::vector<std::string> running_robots();

}  // namespace lithe::control
