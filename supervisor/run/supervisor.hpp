// SPDX-License-Identifier: Apache-2.0
// `lithe run`: start-up (boot.cpp, first_law.cpp), event loop (supervisor.cpp) and shutdown (stop.cpp) of one robot.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "host/read/throttle.hpp"
#include "host/tune/shield/shield.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/core/lines.hpp"
#include "supervisor/core/process.hpp"
#include "supervisor/events/event_log.hpp"
#include "supervisor/incident/incidents.hpp"
#include "supervisor/link/services/services.hpp"
#include "supervisor/link/spine/commands.hpp"
#include "supervisor/link/spine/spine_link.hpp"
#include "supervisor/serve/server.hpp"
#include "supervisor/serve/verbs.hpp"
#include "supervisor/swap/swaps.hpp"

namespace lithe::control {

enum class Drives { driven, damped, off };

// The most active state of all drives. A drive that did not answer in this record counts as driven, because its state
// is unknown. Damped: the drive brakes its joint by itself, after an e-stop or a watchdog timeout. A drive with a fault
// is off.
Drives drives_of(const wire::Telemetry& now);

// Names of the joints whose drives are not off, for a message.
std::string joints_not_off(const robot::RobotConfig& robot, const wire::Telemetry& now);

// Files of a robot in the run folder, behind its name; with .pid and .sock.
inline constexpr const char* kLogEnding = ".spine.log";  // of the Spine
inline constexpr const char* kValuesEnding = ".values";  // RobotConfig::values of the Spine, for who adopts it

struct RunOptions {
  std::string config_path;
  std::string law;      // overrides the file's; empty: the file's
  std::string laws;     // folder of the laws that come with LITHE: for a robot file that was copied without its law
  bool arm = true;      // arm once the law runs
  bool json = false;    // announce in JSON on stdout
  bool shield = false;  // keep all other tasks off the Spine's core for the life of the robot
  bool gates = true;    // false: no admission, no dry run, no trial (--ungated); for tests of containment only
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

  // The value, else Halt with 1.
  template <class T>
  static T must(Result<T> result) {
    if (!result) throw Halt{1, result.message()};
    return std::move(*result);
  }
  // Runs one part, prints its error, returns the exit code. No exception leaves it.
  static int code_of(const std::function<void()>& part);
  void live();

  // Boot, in this order; each throws Halt when the robot cannot run.
  void open_run_folder();
  void take_lease();
  void take_pid_file();
  bool has_pid_file() const;                                                // it is still in its folder
  void write_run_file(const std::string& ending, const std::string& text);  // <robot><ending> in the run folder
  void catch_signals();
  void raise_shield();
  void check_robot();
  void start_lawd();
  void start_trial();
  void compile_first_law();
  void must_run(const std::optional<Answer>& answer, const char* silence) const;
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

  // One turn of the event loop: waits up to `timeout_ms` in poll(), then serves all connections.
  void turn(int timeout_ms);
  // Runs the event loop until `done` returns true. False when the time is over; throws Halt when a signal asks to stop.
  bool turn_until(const std::function<bool()>& done, std::int64_t timeout_ns);
  // Asks, and runs the event loop until the answer has come. Empty when the time is over; throws Halt as turn_until().
  using Take = std::function<void(const Answer&)>;
  using Ask = std::function<void(const Take&)>;
  std::optional<Answer> answer_to(const Ask& ask, std::int64_t timeout_ns);
  // The same, and asks again, a few times, when the machine was too busy to find an answer.
  std::optional<Answer> patient_answer_to(const Ask& ask, std::int64_t timeout_ns);
  void read_signals();
  void read_spine();
  void read_events();
  void note(const Json& event);
  void forward_spine_log();
  void watch_throttling(std::int64_t now_ns);
  void keep_reachable(std::int64_t now_ns);
  [[noreturn]] void spine_died();

  // Halts with 3 when not every drive is known to be off.
  void stop();
  // True when the drives are known to be off.
  bool stop_spine();
  void lower_shield();
  void keep_shield_up(std::int64_t now_ns);
  // Commands the drives off and waits until their replies confirm it. Returns their last state.
  Drives switch_off();

  RunOptions options_;
  robot::RobotConfig config_;
  std::vector<int> all_cpus_;     // the affinity at start
  std::vector<int> shield_cpus_;  // of the Spine and the Transport; empty: they share theirs
  std::vector<int> our_cpus_;     // the supervisor's own, until the Spine has reported its cores
  std::int64_t born_ns_;
  ipc::Lease lease_;
  bool owns_files_ = false;
  Fd run_;       // the run folder
  Fd pid_file_;  // in it, locked
  std::int64_t reachable_ns_ = 0;
  Fd signals_;
  Fd arena_;  // the code arena, handed to lawd, to the trial and to the Spine
  std::optional<host::Shield> shield_;
  std::int64_t shield_kept_ns_ = 0;
  Json shield_told_ = nullptr;  // for status
  LawdLink lawd_;
  TrialLink trial_;
  std::string first_law_, first_source_;  // path and text; empty: none
  std::optional<Process> spine_;
  Fd spine_out_;  // its stdout, until its "ready" line
  std::string spine_said_;
  std::string log_path_;
  std::int64_t log_read_ = 0;
  LineBuffer log_lines_;
  std::string drives_told_;  // what its last line about buses and drives says is wrong; empty = nothing
  bool adopted_ = false;
  bool stopping_ = false;
  bool stop_asked_ = false;
  EventLog events_;
  NoiseFilter noise_;
  host::ThrottleWatch throttle_;
  std::int64_t throttle_read_ns_ = 0;
  std::optional<SpineLink> link_;
  std::optional<Commands> commands_;
  std::optional<Swaps> swaps_;
  std::optional<Incidents> incidents_;
  std::optional<Verbs> verbs_;
  std::optional<Server> server_;
};

Json shield_json(const host::Shield& shield);

}  // namespace lithe::control
