// SPDX-License-Identifier: Apache-2.0
// The verbs of the control socket, one function each.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>

#include "host/read/throttle.hpp"
#include "supervisor/events/event_log.hpp"
#include "supervisor/incident/incidents.hpp"
#include "supervisor/link/services/services.hpp"
#include "supervisor/link/spine/commands.hpp"
#include "supervisor/link/spine/spine_link.hpp"
#include "supervisor/serve/server.hpp"
#include "supervisor/swap/swaps.hpp"

namespace lithe::control {

// The parts of a running robot that verbs act on. All outlive Verbs.
struct Parts {
  const robot::RobotConfig& robot;
  SpineLink& spine;
  LawdLink& lawd;
  TrialLink& trial;
  Commands& commands;
  Swaps& swaps;
  const Incidents& incidents;
  EventLog& log;
  const host::ThrottleWatch& throttle;
  bool adopted;                    // the Spine was started by an earlier supervisor
  const Json& shield;              // of `lithe run --shield`; null without
  const std::string& drives_told;  // what the Spine said last of buses and drives that are not ready; empty = none
};

// Contract: one thread · every request is answered once, now or later, through `reply`.
class Verbs {
 public:
  using Reply = std::function<void(const ReplyTo&, const Answer&)>;

  Verbs(Parts parts, Reply reply, std::function<void()> shutdown);

  void handle(const ReplyTo& to, const std::string& verb, const Json& args);

 private:
  using Function = std::function<void(const ReplyTo&, const Json&)>;

  void add_looks();
  void add_commands();
  void add_swaps();
  using Done = std::function<Answer(const Json&)>;  // makes the answer to the client, when the Spine did it

  std::function<void(const Answer&)> later(const ReplyTo& to, const Done& done = nullptr) const;
  // `law_id`: refused when another law runs by then; 0 = any.
  void command(wire::CommandKind kind, const ReplyTo& to, std::uint32_t count = 0, const Done& done = nullptr,
               std::uint32_t law_id = 0);
  void swap_law(const ReplyTo& to, const Json& args);
  void check_law(const ReplyTo& to, const Json& args);
  void arm(const ReplyTo& to, const Json& args);
  void roll_back(const ReplyTo& to, const Json& args);
  void activate(const ReplyTo& to, const Json& args);
  void go_back(const ReplyTo& to, std::uint32_t steps, const Json& left);
  Json law_that_runs() const;
  void put_source(Json& law) const;
  void set_params(const ReplyTo& to, const Json& args);

  Parts parts_;
  Reply reply_;
  std::function<void()> shutdown_;
  std::map<std::string, Function> verbs_;
};

}  // namespace lithe::control
