// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/client/client.hpp"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <set>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/time.hpp"
#include "supervisor/core/process.hpp"

namespace lithe::control {
namespace {

constexpr const char* kFull = "its queue of clients is full";
constexpr int kLookMs = 100;

// True when the descriptor is ready before the deadline.
bool wait_for(int fd, short events, std::int64_t deadline_ns) {
  for (;;) {
    const std::int64_t left_ms = (deadline_ns - monotonic_ns()) / kNsPerMs + 1;
    pollfd wait{fd, events, 0};
    const int ready = ::poll(&wait, 1, static_cast<int>(std::clamp<std::int64_t>(left_ms, 0, 3'600'000)));
    if (ready > 0) return true;
    if (ready == 0 || errno != EINTR) return false;
  }
}

Refusal gone() {
  return {"disconnected", "the supervisor closed the connection",
          "the robot may have stopped: look at the log of `lithe run`"};
}

Answer unpack(const Json& message) {
  if (message.value("ok", false)) return message.value("result", Json::object());
  const Json error = message.value("error", Json::object());
  return Refusal{error.value("code", "bad_answer"), error.value("message", "the supervisor gave no reason"),
                 error.value("next", ""), error.value("detail", Json(nullptr))};
}

}  // namespace

Result<Client> Client::connect(const std::string& socket_path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (socket_path.size() >= sizeof(address.sun_path))
    return Error{fmt::format("socket path {} is too long; set a shorter LITHE_RUN_DIR", socket_path)};
  std::memcpy(address.sun_path, socket_path.c_str(), socket_path.size() + 1);
  Fd fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!fd || ::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    return Error{
        fmt::format("no supervisor answers at {}: {}", socket_path, errno == EAGAIN ? kFull : std::strerror(errno))};
  }
  ucred peer{};
  socklen_t size = sizeof(peer);
  const bool known = ::getsockopt(fd.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0;
  return Client(std::move(fd), known ? peer.pid : 0);
}

bool Client::is_full(const Result<Client>& connected) { return !connected && connected.message().ends_with(kFull); }

bool Client::send_all(const std::string& text, std::int64_t deadline_ns) {
  std::size_t sent = 0;
  while (sent < text.size()) {
    const ssize_t n = ::send(fd_.get(), text.data() + sent, text.size() - sent, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n > 0) {
      sent += static_cast<std::size_t>(n);
    } else if (errno == EAGAIN) {
      if (!wait_for(fd_.get(), POLLOUT, deadline_ns)) return false;
    } else if (errno != EINTR) {
      return false;
    }
  }
  return true;
}

std::uint64_t Client::send(const std::string& verb, const Json& args, std::int64_t deadline_ns) {
  const std::uint64_t id = next_id_++;
  // After a failed send still read: the server may have sent the reason already (for example a request that is too
  // long).
  (void)send_all(dump_line({{"id", id}, {"verb", verb}, {"args", args}}) + '\n', deadline_ns);
  return id;
}

std::optional<Answer> Client::receive(std::uint64_t id, std::int64_t deadline_ns) {
  for (;;) {
    while (const auto line = in_.next()) {
      const Json message = Json::parse(*line, nullptr, false);
      if (message.is_object() && (message.value("id", Json(nullptr)) == id || message["id"].is_null()))
        return unpack(message);
    }
    if (!wait_for(fd_.get(), POLLIN, deadline_ns)) return std::nullopt;
    char chunk[65536];
    const ssize_t got = ::recv(fd_.get(), chunk, sizeof(chunk), 0);
    if (got == 0 || (got < 0 && errno != EINTR && errno != EAGAIN)) return gone();
    in_.feed({chunk, static_cast<std::size_t>(std::max<ssize_t>(got, 0))});
  }
}

Answer Client::call(const std::string& verb, const Json& args, int timeout_ms) {
  const std::int64_t deadline_ns = monotonic_ns() + timeout_ms * kNsPerMs;
  if (auto answer = receive(send(verb, args, deadline_ns), deadline_ns)) return *answer;
  if (is_question(verb)) {
    return Refusal{"timeout", fmt::format("{}: no answer within {} ms; nothing was changed", verb, timeout_ms),
                   "is the supervisor stopped, or the machine busy? lithe list"};
  }
  return Refusal{"timeout",
                 fmt::format("{} is not confirmed: no answer within {} ms; it may still take effect", verb, timeout_ms),
                 "see what the robot does: lithe status, or the log of `lithe run`"};
}

Client::Pulse Client::pulse() {
  const std::int64_t began_ns = monotonic_ns();
  const std::uint64_t id = send("ping", Json::object(), began_ns + kLookMs * kNsPerMs);
  for (;;) {
    if (const auto answer = receive(id, monotonic_ns() + kLookMs * kNsPerMs)) {
      const auto* refusal = std::get_if<Refusal>(&*answer);
      return refusal != nullptr && refusal->code == "disconnected" ? Pulse::gone : Pulse::answers;
    }
    const char state = state_of(peer_pid_);
    const std::int64_t quiet_ms = (monotonic_ns() - began_ns) / kNsPerMs;
    if (is_stopped(state)) return Pulse::stopped;
    if (quiet_ms >= kBusyMs || (quiet_ms >= kQuietMs && state != 'R' && state != 'D')) return Pulse::silent;
  }
}

bool is_question(const std::string& verb) {
  static const std::set<std::string> questions = {"ping", "status", "events", "params", "law_list", "law_check"};
  return questions.count(verb) != 0;
}

std::vector<std::string> running_robots() {
  std::vector<std::string> names;
  for (const std::filesystem::path& path : files_in(run_dir())) {
    if (path.extension() != ".sock") continue;
    const auto client = Client::connect(path.string());
    if (client || Client::is_full(client)) names.push_back(path.stem().string());
  }
  return names;
}

}  // namespace lithe::control
