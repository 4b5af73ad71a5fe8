// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/services/service_link.hpp"

#include <fmt/format.h>
#include <signal.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>
#include <utility>

namespace lithe::control {

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
  if (!process_) return;
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
  process_->signal(SIGKILL);
  process_->wait(1000);
  const std::string had = fmt::format("{:.1f} s of the processor in {:.1f} s", cpu_s, wall_s);
  if (work.wants_to_run && cpu_s < 0.5 * wall_s)
    on_death("the machine is too busy: the " + name_ + " got " + had, now_ns, true);
  else
    on_death("it had " + had + ", was not done and was stopped", now_ns);
}

void ServiceLink::on_death(std::string why, std::int64_t now_ns, bool starved) {
  spdlog::error("{} is gone: {}", name_, why);
  process_.reset();
  socket_.reset();
  restart_at_ns_ = now_ns + kRestartPauseNs;
  if (!active_) return;
  // The request that was sent is refused; requests not sent yet wait for the next process.
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

}  // namespace lithe::control
