// SPDX-License-Identifier: Apache-2.0
// The supervisor's connections to the two processes that it asks about laws: the compile service (lawd) and the trial
// (lithe-trial). Both answer JSON lines. They may crash; they are then started again.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

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
  // By value: `why` may refer to the process that is being replaced.
  void on_death(std::string why, std::int64_t now_ns);
  void refuse_active(const std::string& why, bool starved);
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

struct LawText {
  std::string name;
  std::string source;
  std::uint32_t budget_ns = 0;  // time limit of a step; 0 = not checked
};

// Location of a law, as lawd reported it. slot 0: not in the arena; it is loaded with dlopen.
struct Placed {
  std::uint32_t slot = 0;
  std::uint32_t code_bytes = 0;
  std::uint64_t entry = 0;
  std::uint64_t image_hash = 0;
  double place_ms = 0.0;
};

// Contract: as ServiceLink. Answers are lawd's own on success; a Refusal carries the diagnostics in `detail`.
class LawdLink : public ServiceLink {
 public:
  using PlacedCallback = std::function<void(const std::variant<Placed, Refusal>&)>;
  static constexpr std::size_t kMaxChecks = 8;

  // `program`: path of lawd. `cpus`: cores that lawd and its compilers may use. `joints`: number of joints in the dry
  // run. `compile_s`: the longest time for the compiler of one law.
  LawdLink(std::string program, std::vector<int> cpus, std::size_t joints, double compile_s = 20.0);

  // For one answer, from when lawd receives the request: the compiler waits for the processor, too.
  std::int64_t limit_ns() const { return limit_ns_; }

  // Switches admission and dry run off: for tests of the containment in the Spine.
  void open_gates() { gates_ = false; }
  // Refused when others could put files into the cache: what is compiled there becomes the robot's code.
  Result<> start(std::int64_t now_ns);

  void compile(const LawText& law, Callback callback, std::int64_t now_ns);
  // The same for `law check`: every compile() goes first, and at most kMaxChecks wait.
  void check(const LawText& law, Callback callback, std::int64_t now_ns);
  // Links a compiled law for a slot of the arena and writes it there. `hash`: from the answer to compile().
  void place(const std::string& hash, std::uint32_t slot, PlacedCallback callback, std::int64_t now_ns);
  // Answers {"line", "function"} for an offset [bytes] from the start of the law's slot, or of its object.
  void locate(const std::string& hash, std::uint64_t offset, bool placed, Callback callback, std::int64_t now_ns);

 private:
  Json compile_request(const LawText& law) const;

  std::size_t joints_;
  std::int64_t limit_ns_;
  bool gates_ = true;
};

// A trial request.
struct TrialRequest {
  std::string object;  // shared object
  Placed placed;       // slot 0: the shared object is tried
  std::uint32_t budget_ns = 0;
  int box_ms = 150;
  std::string recording;  // name of the robot whose last telemetry is replayed
  Json params = Json::object();
};

// Contract: as ServiceLink
class TrialLink : public ServiceLink {
 public:
  static constexpr int kMostStarved = 5;  // attempts without processor time before the law is refused

  // `program`: path of lithe-trial; `robot_file`: absolute.
  TrialLink(std::string program, std::string robot_file, std::vector<int> cpus);

  // Logs a warning when the trial cannot map the given arena.
  Result<> start(std::int64_t now_ns);
  // Answers {"safe_law_text"}: what was wrong when the safe law stopped the simulated robot; "" = nothing.
  // `limit_ns`: for the answer, its simulated runs included.
  void ask_safe_law(Callback callback, std::int64_t limit_ns, std::int64_t now_ns);
  // On success: the trial's report. Refusal: trial_failed (the report in `detail.trial`, with "pc_offset" of a crash),
  // trial_starved, trial_died, or trial_unavailable (the sandbox does not work on this machine). With Turn::idle every
  // other trial goes before it, and one without processor time is not repeated.
  void attempt(const TrialRequest& trial, Callback callback, std::int64_t now_ns, Turn turn = Turn::in_line,
               int starved = 0);
};

}  // namespace lithe::control
