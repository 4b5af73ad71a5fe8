// SPDX-License-Identifier: Apache-2.0
#include "supervisor/control/lawd_link.hpp"

#include <fmt/format.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>

#include <algorithm>
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

void LawdLink::compile(const std::string& name, const std::string& source, Callback callback, std::int64_t now_ns) {
  const std::uint64_t id = next_id_++;
  const Json request = {{"id", id}, {"verb", "compile"}, {"name", name}, {"source", source}, {"joints", joints_}};
  pending_[id] = {std::move(callback), swap::dump_line(request) + '\n', now_ns + kCompileTimeoutNs, false};
  write_requests();
}

void LawdLink::place(const std::string& hash, std::uint32_t slot, Callback callback, std::int64_t now_ns) {
  const std::uint64_t id = next_id_++;
  const Json request = {{"id", id}, {"verb", "place"}, {"hash", hash}, {"slot", slot}};
  pending_[id] = {std::move(callback), swap::dump_line(request) + '\n', now_ns + kCompileTimeoutNs, false};
  write_requests();
}

void LawdLink::serve(std::int64_t now_ns) {
  if (process_) {
    write_requests();
    read_answers();
    const bool late = std::any_of(pending_.begin(), pending_.end(),
                                  [now_ns](const auto& each) { return now_ns > each.second.deadline_ns; });
    if (late) {
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
    } else {
      spdlog::warn("compile service started again (pid {})", pid());
    }
  }
}

void LawdLink::write_requests() {
  if (!process_) {
    return;
  }
  for (auto& [id, each] : pending_) {
    if (!each.sent) {
      out_ += each.request;
      each.sent = true;
    }
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
  const auto found = pending_.find(answer["id"].get<std::uint64_t>());
  if (found == pending_.end()) {
    return;
  }
  const Callback callback = std::move(found->second.callback);
  pending_.erase(found);
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
  // What it had in its hands is refused; what it never saw waits for its successor.
  std::vector<Callback> victims;
  for (auto it = pending_.begin(); it != pending_.end();) {
    if (it->second.sent || now_ns > it->second.deadline_ns) {
      victims.push_back(std::move(it->second.callback));
      it = pending_.erase(it);
    } else {
      ++it;
    }
  }
  for (const Callback& callback : victims) {
    callback(Refusal{"lawd_died", fmt::format("the compile service died over this law: {}", why),
                     "the running law is unchanged; the service is started again, try once more"});
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
