// SPDX-License-Identifier: Apache-2.0
// `lithe run`: looks after one robot from the first check of its file to the last drive switched off.
#pragma once

#include <poll.h>

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "spine/ipc/segment.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/control/commands.hpp"
#include "supervisor/control/drives.hpp"
#include "supervisor/control/event_log.hpp"
#include "supervisor/control/lawd_link.hpp"
#include "supervisor/control/noise.hpp"
#include "supervisor/control/process.hpp"
#include "supervisor/control/server.hpp"
#include "supervisor/control/spine_link.hpp"
#include "supervisor/control/swaps.hpp"
#include "supervisor/control/trial_link.hpp"
#include "supervisor/control/verbs.hpp"

namespace lithe::control {

struct RunOptions {
  std::string config_path;
  std::string law;    // overrides the file's; empty: the file's
  bool arm = true;    // arm once the law runs
  bool json = false;  // announce in JSON on stdout
  bool gates = true;  // false: no admission, no dry run, no trial; for tests of containment only
};

// Checks, starts, serves until SIGINT, SIGTERM or a shutdown request, stops. Returns the exit code of `lithe run`:
// 0 stopped as asked, 1 refused, 2 wrong robot file, 3 the Spine died, the supervisor itself went wrong, or it could
// not confirm that every drive is off.
int run_robot(const RunOptions& options);

// Contract: one thread; blocks SIGINT, SIGTERM and SIGHUP for the process.
class Supervisor {
 public:
  Supervisor(RunOptions options, robot::RobotConfig config);
  ~Supervisor();

  int run();

 private:
  struct Halt {
    int code;
    std::string message;
  };

  // Runs a part of the run to its end, says what went wrong, returns the exit code. Lets nothing escape.
  static int code_of(const std::function<void()>& part);
  void live();

  // Boot, in this order; each throws Halt when the robot cannot run.
  void take_lease();
  void catch_signals();
  void check_robot();
  void start_lawd();
  void start_trial();
  void compile_first_law();
  void try_safe_law();
  void start_spine();
  void adopt_spine(pid_t pid);
  void attach();
  void serve_spine(SpineLink link);
  void swap_first_law();
  void swap_adopted_law();
  void arm();
  void open_socket();
  void announce() const;

  // One turn: waits up to `timeout_ms`, then serves everybody.
  void turn(int timeout_ms);
  // Turns until `done` says so. False when the time is over; throws Halt when a signal asks to stop.
  bool turn_until(const std::function<bool()>& done, std::int64_t timeout_ns);
  void read_signals();
  void read_spine();
  void read_events();
  void note(const Json& event);
  void forward_spine_log();
  [[noreturn]] void spine_died();

  // Halts with 3 when not every drive is known to be off.
  void stop();
  // True when the drives are known to be off.
  bool stop_spine();
  // Asks for drives off and waits for the drives themselves to say so; what they said last.
  Drives switch_off();

  RunOptions options_;
  robot::RobotConfig config_;
  std::vector<int> all_cpus_;  // with which we were started
  std::vector<int> our_cpus_;  // of these, until the Spine has said where it runs
  std::int64_t born_ns_;
  ipc::Lease lease_;
  bool owns_files_ = false;
  Fd signals_;
  Fd arena_;  // the code arena, handed to lawd, to the trial and to the Spine
  LawdLink lawd_;
  TrialLink trial_;
  std::string first_source_;
  std::optional<Process> spine_;
  Fd spine_out_;  // its stdout, until it has said that it is ready
  std::string spine_said_;
  std::string log_path_;
  std::int64_t log_read_ = 0;
  std::string log_tail_;
  bool adopted_ = false;
  bool stopping_ = false;
  bool stop_asked_ = false;
  EventLog events_;
  NoiseFilter noise_;
  std::optional<SpineLink> link_;
  std::optional<Commands> commands_;
  std::optional<Swaps> swaps_;
  std::optional<Verbs> verbs_;
  std::optional<Server> server_;
};

}  // namespace lithe::control
