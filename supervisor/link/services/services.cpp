// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/services/services.hpp"

#include <fmt/format.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/time.hpp"

namespace lithe::control {
namespace {

// lawd names the stage that failed; the first error, with file and line, becomes the message.
Refusal lawd_refusal(const Json& answer) {
  const std::string stage = answer.value("stage", "compile");
  const std::string text = answer.value("text", "");
  const Json diagnostics = answer.value("diagnostics", Json::array());
  std::string message = text.substr(0, text.find('\n'));
  for (const Json& each : diagnostics) {
    if (each.value("severity", "") == "error" || each.value("severity", "") == "fatal error") {
      message = each.value("file", "?");
      for (const char* place : {"line", "column"})  // an unknown position is left out
        if (each.value(place, 0) > 0) message += fmt::format(":{}", each.value(place, 0));
      message += ": " + each.value("message", "");
      break;
    }
  }
  if (message.empty()) message = "the compile service gave no reason";
  Json detail = {{"stage", stage}, {"diagnostics", diagnostics}, {"text", text}};
  for (const char* key : {"gates", "cleaned"})
    if (answer.contains(key)) detail[key] = answer[key];
  const std::string next = answer.value("next", "the running law is unchanged; correct the source and swap again");
  return {answer.value("starved", false) ? "compile_starved" : stage + "_failed", message, next, detail};
}

// lawd's own answer, or a refusal in its place.
ServiceLink::Callback judged(ServiceLink::Callback callback) {
  return [callback = std::move(callback)](const Answer& answer) {
    const Json* json = std::get_if<Json>(&answer);
    if (json == nullptr) return callback(answer);
    if (!json->value("ok", false)) return callback(lawd_refusal(*json));
    Json result = *json;
    result.erase("ok");
    callback(result);
  };
}

Json try_request(const TrialRequest& trial) {
  Json request = {{"verb", "try"},
                  {"robot", trial.recording},
                  {"budget_ns", trial.budget_ns},
                  {"box_ms", trial.box_ms},
                  {"params", trial.params}};
  if (trial.placed.slot == 0) {
    request["object"] = trial.object;
  } else {
    request["slot"] = trial.placed.slot;
    request["code_bytes"] = trial.placed.code_bytes;
    request["entry"] = trial.placed.entry;
    request["image_hash"] = trial.placed.image_hash;
  }
  return request;
}

Refusal trial_refusal(const Json& answer) {
  const bool starved = answer.value("starved", false), unavailable = answer.value("unavailable", false);
  const std::string reason = answer.value("reason", "the trial gave no reason");
  const Json hints = answer.value("hints", Json::array());
  const std::string hint = hints.empty() ? "correct the source and swap again" : hints[0].get<std::string>();
  return {starved       ? "trial_starved"
          : unavailable ? "trial_unavailable"
                        : "trial_failed",
          fmt::format("{}: {}", answer.value("section", "?"), reason),
          starved       ? std::string("the running law is unchanged; try again when the machine is less busy")
          : unavailable ? "the running law is unchanged, and nothing is known against the new one: a trial needs "
                          "seccomp, resource limits and, with [spine] loader = arena, the arena: see docs/swap.md"
                        : "the running law is unchanged; " + hint,
          {{"stage", "trial"}, {"trial", answer}}};
}

}  // namespace

Result<> ServiceLink::start(std::int64_t now_ns) {
  int pair[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0)
    return Error{fmt::format("cannot make a socket pair for the {}: {}", name_, std::strerror(errno))};
  socket_.reset(pair[0]);
  const Fd theirs(pair[1]);
  Launch launch = launch_;
  launch.stdin_fd = theirs.get();
  launch.stdout_fd = theirs.get();
  launch.own_session = true;
  launch.dies_with_parent = true;
  Result<Process> process = Process::start(launch);
  restart_at_ns_ = now_ns + kRestartPauseNs;
  if (!process) {
    socket_.reset();
    return process.error();
  }
  process_.emplace(std::move(*process));
  in_ = LineBuffer(std::size_t{64} << 20);
  out_.clear();
  return done();
}

void ServiceLink::ask(Json request, Turn turn, std::int64_t limit_ns, Callback callback, std::int64_t now_ns) {
  const std::uint64_t id = next_id_++;
  Json numbered = {{"id", id}};
  numbered.update(request);
  Job job{id, dump_line(numbered) + '\n', limit_ns, std::move(callback)};
  if (turn == Turn::next)
    line_.push_front(std::move(job));
  else
    (turn == Turn::idle ? idle_ : line_).push_back(std::move(job));
  write_requests(now_ns);
}

void ServiceLink::serve(std::int64_t now_ns) {
  if (process_) {
    read_answers();
    write_requests(now_ns);
    if (active_ && now_ns > active_->deadline_ns)
      out_of_time(now_ns);
    else if (process_->ended())
      on_death(process_->verdict(), now_ns);
  }
  if (!process_ && now_ns >= restart_at_ns_) {
    ++restarts_;
    const Result<> started = start(now_ns);
    if (!started) {
      on_death(started.message(), now_ns);
      refuse_waiting(started.message());
    } else {
      spdlog::warn("{} started again (pid {})", name_, pid());
      write_requests(now_ns);
    }
  }
}

void ServiceLink::write_requests(std::int64_t now_ns) {
  if (!process_ || !socket_) return;  // without a socket it is dying
  if (!active_ && !(line_.empty() && idle_.empty())) {
    std::deque<Job>& from = line_.empty() ? idle_ : line_;
    out_ += from.front().request;
    active_ = Active{from.front().id, std::move(from.front().callback), now_ns, now_ns + from.front().limit_ns,
                     work_of_session(process_->pid()).cpu_s};
    from.pop_front();
  }
  while (!out_.empty()) {
    const ssize_t sent = ::send(socket_.get(), out_.data(), out_.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent <= 0) return;  // socket full, or service dead: serve() handles both
    out_.erase(0, static_cast<std::size_t>(sent));
  }
}

void ServiceLink::read_answers() {
  char chunk[65536];
  ssize_t got = 0;
  while ((got = ::recv(socket_.get(), chunk, sizeof(chunk), MSG_DONTWAIT)) > 0)
    in_.feed({chunk, static_cast<std::size_t>(got)});
  while (const auto line = in_.next()) take(*line);
  if (got != 0) return;
  // It has closed its end, so it is dying, or of no use any more. poll() would return at once until it is dead; and a
  // service of idle priority gets no processor time to die beside a loop that never waits.
  socket_.reset();
  process_->signal(SIGKILL);
}

void ServiceLink::take(const std::string& line) {
  Json answer = Json::parse(line, nullptr, false);
  if (!answer.is_object() || !answer.contains("id") || !answer["id"].is_number_unsigned())
    return;  // its start message, or output of a tool
  if (!active_ || active_->id != answer["id"].get<std::uint64_t>()) return;
  const Callback callback = std::move(active_->callback);
  active_.reset();
  answer.erase("id");
  try {
    callback(printable_json(answer));  // it contains text of compilers and laws
  } catch (const Json::exception& wrong) {
    callback(Refusal{word_ + "_failed", fmt::format("the {} answered nonsense: {}", name_, wrong.what()),
                     "the running law is unchanged; is the build complete (make)?"});
  }
}

// Judged by processor time: when the service was ready to run but got no processor time, the timeout is no evidence
// against the law.
void ServiceLink::out_of_time(std::int64_t now_ns) {
  const Work work = work_of_session(process_->pid());
  const double wall_s = 1e-9 * static_cast<double>(now_ns - active_->began_ns), cpu_s = work.cpu_s - active_->cpu_s;
  process_->signal(SIGKILL);  // serve() sees its end, and starts it again
  socket_.reset();
  const std::string had = fmt::format("{:.1f} s of the processor in {:.1f} s", cpu_s, wall_s);
  if (work.wants_to_run && cpu_s < 0.5 * wall_s)
    refuse_active("the machine is too busy: the " + name_ + " got " + had, true);
  else
    refuse_active("it had " + had + ", was not done and was stopped", false);
}

void ServiceLink::on_death(std::string why, std::int64_t now_ns) {
  spdlog::error("{} is gone: {}", name_, why);
  process_.reset();
  socket_.reset();
  restart_at_ns_ = now_ns + kRestartPauseNs;
  refuse_active(why, false);
}

// The request that was sent; those not sent yet wait for the next process.
void ServiceLink::refuse_active(const std::string& why, bool starved) {
  if (!active_) return;
  const Callback callback = std::move(active_->callback);
  active_.reset();
  if (starved) {
    return callback(Refusal{
        starved_, why,
        "the running law is unchanged; nothing is known against the law: try again when the machine is less busy"});
  }
  callback(Refusal{word_ + "_died", fmt::format("the {} died over this law: {}", name_, why),
                   "the running law is unchanged; the service is started again, try once more"});
}

// The restart failed too: refuse all waiting requests.
void ServiceLink::refuse_waiting(const std::string& why) {
  for (std::deque<Job>* jobs : {&line_, &idle_}) {
    for (const Job& each : std::exchange(*jobs, {})) {
      each.callback(Refusal{word_ + "_failed", fmt::format("the {} cannot be started: {}", name_, why),
                            "the running law is unchanged; is the build complete (make)?"});
    }
  }
}

void ServiceLink::stop() {
  if (!process_) return;
  socket_.reset();  // end of its input: it exits by itself
  if (!process_->wait(300)) {
    process_->signal(SIGTERM);
    if (!process_->wait(1000)) {
      process_->signal(SIGKILL);
      process_->wait(2000);
    }
  }
  process_.reset();
}

LawdLink::LawdLink(std::string program, std::vector<int> cpus, std::size_t joints, double compile_s)
    : ServiceLink(
          "lawd", "compile service", "compile_starved",
          {.argv = {std::move(program), fmt::format("{}", compile_s)}, .idle_priority = true, .cpus = std::move(cpus)}),
      joints_(joints),
      limit_ns_(static_cast<std::int64_t>(3e9 * compile_s)) {}

Result<> LawdLink::start(std::int64_t now_ns) {
  // An absent folder is made by lawd, or in vain: it says why. Without HOME the cache is in the run folder.
  for (const auto& [folder, variable] : {std::pair(run_dir(), "LITHE_RUN_DIR"), {cache_dir(), "LITHE_CACHE_DIR"}})
    if (const auto own = open_own_folder(folder, variable); !own) return own.error();
  return ServiceLink::start(now_ns);
}

Json LawdLink::compile_request(const LawText& law) const {
  Json request = {{"verb", "compile"}, {"name", law.name}, {"source", law.source}, {"joints", joints_}};
  if (!gates_) {
    request["admit"] = false;
    request["dry_run"] = false;
  } else if (law.budget_ns != 0) {
    request["budget_ns"] = law.budget_ns;
  }
  return request;
}

void LawdLink::compile(const LawText& law, Callback callback, std::int64_t now_ns) {
  ask(compile_request(law), Turn::in_line, limit_ns_, judged(std::move(callback)), now_ns);
}

void LawdLink::check(const LawText& law, Callback callback, std::int64_t now_ns) {
  if (idle_waiting() >= kMaxChecks) {
    return callback(Refusal{"busy", fmt::format("{} laws wait already to be checked", idle_waiting()),
                            "try again when one of them is answered"});
  }
  ask(compile_request(law), Turn::idle, limit_ns_, judged(std::move(callback)), now_ns);
}

void LawdLink::place(const std::string& hash, std::uint32_t slot, PlacedCallback callback, std::int64_t now_ns) {
  const auto take = [slot, callback = std::move(callback)](const Answer& answer) {
    if (const auto* refusal = std::get_if<Refusal>(&answer)) return callback(*refusal);
    const Json& placed = std::get<Json>(answer);
    callback(Placed{slot, placed.value("code_bytes", std::uint32_t{0}), placed.value("entry", std::uint64_t{0}),
                    placed.value("image_hash", std::uint64_t{0}), placed.value("place_ms", 0.0)});
  };
  // The running check belongs to the law whose turn it is.
  ask({{"verb", "place"}, {"hash", hash}, {"slot", slot}}, Turn::next, limit_ns_, judged(take), now_ns);
}

void LawdLink::locate(const std::string& hash, std::uint64_t offset, bool placed, Callback callback,
                      std::int64_t now_ns) {
  ask({{"verb", "locate"}, {"hash", hash}, {"offset", offset}, {"placed", placed}}, Turn::in_line, limit_ns_,
      judged(std::move(callback)), now_ns);
}

TrialLink::TrialLink(std::string program, std::string robot_file, std::vector<int> cpus)
    : ServiceLink("trial", "trial", "trial_starved",
                  {.argv = {std::move(program), std::move(robot_file)}, .cpus = std::move(cpus)}) {}

Result<> TrialLink::start(std::int64_t now_ns) {
  const auto started = ServiceLink::start(now_ns);
  if (!started || given() < 0) return started;
  const auto take = [](const Answer& answer) {
    const Json* json = std::get_if<Json>(&answer);
    if (json != nullptr && !json->value("arena", false)) {
      spdlog::error("the trial cannot have the arena ({}): every placed law will be refused as trial_unavailable",
                    json->value("arena_text", ""));
    }
  };
  ask({{"verb", "ping"}}, Turn::next, 10 * kNsPerS, take, now_ns);
  return started;
}

void TrialLink::ask_safe_law(Callback callback, std::int64_t limit_ns, std::int64_t now_ns) {
  ask({{"verb", "ping"}}, Turn::next, limit_ns, std::move(callback), now_ns);
}

void TrialLink::attempt(const TrialRequest& trial, Callback callback, std::int64_t now_ns, Turn turn, int starved) {
  const std::int64_t limit_ns = 4 * trial.box_ms * kNsPerMs + 10 * kNsPerS;
  const int most = turn == Turn::idle ? 1 : kMostStarved;
  const auto take = [this, trial, turn, starved, most, callback = std::move(callback)](const Answer& answer) {
    const Json* json = std::get_if<Json>(&answer);
    if (json == nullptr || json->value("ok", false))
      callback(answer);
    else if (json->value("starved", false) && starved + 1 < most)
      attempt(trial, callback, monotonic_ns(), turn, starved + 1);
    else
      callback(trial_refusal(*json));
  };
  ask(try_request(trial), turn, limit_ns, take, now_ns);
}

}  // namespace lithe::control
