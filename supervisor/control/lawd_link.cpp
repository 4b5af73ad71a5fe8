// SPDX-License-Identifier: Apache-2.0
#include "supervisor/control/lawd_link.hpp"

#include <fmt/format.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>
#include <utility>

namespace lithe::control {
namespace {

using swap::Answer;
using swap::Json;
using swap::Refusal;

// lawd says where it stopped; the first error, with file and line, becomes the message.
Refusal refusal_of(const Json& answer) {
  const std::string stage = answer.value("stage", "compile");
  const std::string text = answer.value("text", "");
  const Json diagnostics = answer.value("diagnostics", Json::array());
  std::string message = text.substr(0, text.find('\n'));
  for (const Json& each : diagnostics) {
    if (each.value("severity", "") == "error" || each.value("severity", "") == "fatal error") {
      message = fmt::format("{}:{}:{}: {}", each.value("file", "?"), each.value("line", 0), each.value("column", 0),
                            each.value("message", ""));
      break;
    }
  }
  if (message.empty()) {
    message = "the compile service gave no reason";
  }
  return {stage + "_failed",
          message,
          "the running law is unchanged; correct the source and swap again",
          {{"stage", stage}, {"diagnostics", diagnostics}, {"text", text}}};
}

}  // namespace

Result<> LawdLink::start(std::int64_t now_ns) {
  int pair[2];
  if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, pair) != 0) {
    return Error{fmt::format("cannot make a socket pair for lawd: {}", std::strerror(errno))};
  }
  socket_.reset(pair[0]);
  const Fd theirs(pair[1]);
  Launch launch;
  launch.argv = {program_};
  launch.stdin_fd = theirs.get();
  launch.stdout_fd = theirs.get();
  launch.extra_fd = arena_fd_;
  launch.own_session = true;
  launch.dies_with_parent = true;
  launch.idle_priority = true;
  launch.cpus = cpus_;
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

LawdLink::Job LawdLink::job(const std::string& name, const std::string& source, Callback callback) {
  const std::uint64_t id = next_id_++;
  const Json request = {{"id", id}, {"verb", "compile"}, {"name", name}, {"source", source}, {"joints", joints_}};
  return {id, swap::dump_line(request) + '\n', std::move(callback)};
}

void LawdLink::compile(const std::string& name, const std::string& source, Callback callback, std::int64_t now_ns) {
  swaps_.push_back(job(name, source, std::move(callback)));
  write_requests(now_ns);
}

void LawdLink::check(const std::string& name, const std::string& source, Callback callback, std::int64_t now_ns) {
  if (checks_.size() >= kMaxChecks) {
    callback(Refusal{"busy", fmt::format("{} laws wait already to be checked", checks_.size()),
                     "try again when one of them is answered"});
    return;
  }
  checks_.push_back(job(name, source, std::move(callback)));
  write_requests(now_ns);
}

void LawdLink::place(const std::string& hash, std::uint32_t slot, Callback callback, std::int64_t now_ns) {
  const std::uint64_t id = next_id_++;
  const Json request = {{"id", id}, {"verb", "place"}, {"hash", hash}, {"slot", slot}};
  swaps_.push_front({id, swap::dump_line(request) + '\n', std::move(callback)});  // its law is the next one's turn
  write_requests(now_ns);
}

void LawdLink::serve(std::int64_t now_ns) {
  if (process_) {
    read_answers();
    write_requests(now_ns);
    if (active_ && now_ns > active_->deadline_ns) {
      process_->signal(SIGKILL);
      process_->wait(1000);
      buried("it took too long and was stopped", now_ns);
    } else if (process_->ended()) {
      buried(process_->verdict(), now_ns);
    }
  }
  if (!process_ && now_ns >= restart_at_ns_) {
    ++restarts_;
    const Result<> started = start(now_ns);
    if (!started) {
      buried(started.message(), now_ns);
      refuse_waiting(started.message());
    } else {
      spdlog::warn("compile service started again (pid {})", pid());
      write_requests(now_ns);
    }
  }
}

void LawdLink::write_requests(std::int64_t now_ns) {
  if (!process_) {
    return;
  }
  if (!active_ && !(swaps_.empty() && checks_.empty())) {
    std::deque<Job>& from = swaps_.empty() ? checks_ : swaps_;
    out_ += from.front().request;
    active_ = Active{from.front().id, std::move(from.front().callback), now_ns + kCompileTimeoutNs};
    from.pop_front();
  }
  while (!out_.empty()) {
    const ssize_t sent = ::send(socket_.get(), out_.data(), out_.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent <= 0) {
      return;  // full, or dead: serve() finds out which
    }
    out_.erase(0, static_cast<std::size_t>(sent));
  }
}

void LawdLink::read_answers() {
  char chunk[65536];
  ssize_t got = 0;
  while ((got = ::recv(socket_.get(), chunk, sizeof(chunk), MSG_DONTWAIT)) > 0) {
    in_.feed({chunk, static_cast<std::size_t>(got)});
  }
  while (const auto line = in_.next()) {
    take(*line);
  }
}

void LawdLink::take(const std::string& line) {
  const Json answer = Json::parse(line, nullptr, false);
  if (!answer.is_object() || !answer.contains("id") || !answer["id"].is_number_unsigned()) {
    return;  // its greeting, or a line somebody's tool printed
  }
  if (!active_ || active_->id != answer["id"].get<std::uint64_t>()) {
    return;
  }
  const Callback callback = std::move(active_->callback);
  active_.reset();
  try {
    callback(answer.value("ok", false) ? Answer(answer) : Answer(refusal_of(answer)));
  } catch (const Json::exception& wrong) {
    callback(Refusal{"lawd_failed", fmt::format("the compile service answered nonsense: {}", wrong.what()),
                     "the running law is unchanged; is the build complete (make)?"});
  }
}

void LawdLink::buried(std::string why, std::int64_t now_ns) {
  spdlog::error("compile service is gone: {}", why);
  process_.reset();
  socket_.reset();
  restart_at_ns_ = now_ns + kRestartPauseNs;
  if (!active_) {
    return;
  }
  // What it had in its hands is refused; what it never saw waits for its successor.
  const Callback callback = std::move(active_->callback);
  active_.reset();
  callback(Refusal{"lawd_died", fmt::format("the compile service died over this law: {}", why),
                   "the running law is unchanged; the service is started again, try once more"});
}

// No successor either: nobody waits for one that may never come.
void LawdLink::refuse_waiting(const std::string& why) {
  for (std::deque<Job>* jobs : {&swaps_, &checks_}) {
    for (const Job& each : std::exchange(*jobs, {})) {
      each.callback(Refusal{"lawd_failed", fmt::format("the compile service cannot be started: {}", why),
                            "the running law is unchanged; is the build complete (make)?"});
    }
  }
}

void LawdLink::stop() {
  if (!process_) {
    return;
  }
  socket_.reset();  // end of its input: it leaves by itself
  if (!process_->wait(300)) {
    process_->signal(SIGTERM);
    if (!process_->wait(1000)) {
      process_->signal(SIGKILL);
      process_->wait(2000);
    }
  }
  process_.reset();
}

}  // namespace lithe::control
