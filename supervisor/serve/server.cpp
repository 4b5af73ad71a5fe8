// SPDX-License-Identifier: Apache-2.0
#include "supervisor/serve/server.hpp"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <exception>
#include <optional>
#include <string_view>
#include <utility>

#include "spine/core/text.hpp"

namespace lithe::control {
namespace {

constexpr std::size_t kMaxShownBytes = 100;
constexpr int kRequestsPerTurn = 16;    // of one client; in between the others are served and the heartbeat is sent
constexpr std::size_t kMostTold = 200;  // of what the JSON reader says
constexpr int kMostNested = 32;         // arguments are two objects deep; the JSON reader and writer are recursive

std::string answer_line(const Json& id, const Answer& answer) {
  Json out = {{"id", id}};
  if (const Json* result = std::get_if<Json>(&answer)) {
    out["ok"] = true;
    out["result"] = *result;
  } else {
    out["ok"] = false;
    out["error"] = std::get<Refusal>(answer).to_json();
  }
  return dump_line(out) + '\n';
}

// Names from a client reach logs, certificates and terminals. Returns the first argument that is not printable, in
// escaped form. The source text of a law is checked by lawd.
std::optional<std::string> unprintable_in(const Json& value, std::string_view name = {}) {
  const auto shown = [](const std::string& text) { return printable(text.substr(0, kMaxShownBytes)); };
  if (!is_printable(name)) return shown(std::string(name));
  if (value.is_string() && name != "source" && !is_printable(value.get_ref<const std::string&>()))
    return shown(value.get_ref<const std::string&>());
  if (value.is_structured()) {
    for (const auto& [key, item] : value.items())
      if (auto found = unprintable_in(item, key)) return found;
  }
  return std::nullopt;
}

// The inode of a file; 0 when there is none.
std::uint64_t inode_of(const std::string& path) {
  struct stat about{};
  return ::lstat(path.c_str(), &about) == 0 ? about.st_ino : 0;
}

Result<Fd> listen_at(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof(address.sun_path)) {
    return Error{fmt::format("socket path {} is longer than {} characters; set a shorter LITHE_RUN_DIR", path,
                             sizeof(address.sun_path) - 1)};
  }
  std::memcpy(address.sun_path, path.c_str(), path.size() + 1);
  Fd listener(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  ::unlink(path.c_str());
  if (!listener || ::bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0 ||
      ::chmod(path.c_str(), 0660) != 0 || ::listen(listener.get(), 16) != 0) {
    return Error{fmt::format("cannot listen on {}: {}; is the directory writable?", path, std::strerror(errno))};
  }
  return listener;
}

}  // namespace

Result<Server> Server::listen(const std::string& path, Handler handler) {
  Server server(path, std::move(handler));
  if (const auto listens = server.listen_again(); !listens) return listens.error();
  return server;
}

Result<> Server::listen_again() {
  Result<Fd> listener = listen_at(path_);
  if (!listener) return listener.error();
  listener_ = std::move(*listener);
  file_ = inode_of(path_);
  return done();
}

bool Server::is_there() const { return inode_of(path_) == file_; }

Server::Server(std::string path, Handler handler) : path_(std::move(path)), handler_(std::move(handler)) {}

Server::Server(Server&& other) noexcept
    : listener_(std::move(other.listener_)),
      file_(other.file_),
      path_(std::exchange(other.path_, {})),
      handler_(std::move(other.handler_)),
      clients_(std::move(other.clients_)),
      next_client_(other.next_client_) {}

Server::~Server() {
  if (!path_.empty()) ::unlink(path_.c_str());
}

void Server::add_poll_fds(std::vector<pollfd>& fds) const {
  fds.push_back({listener_.get(), POLLIN, 0});
  for (const auto& [key, client] : clients_) {
    const bool writes = !client.out.empty() || client.behind;  // behind: so that poll() returns at once
    const int events = (client.ended ? 0 : POLLIN) | (writes ? POLLOUT : 0);
    fds.push_back({client.fd.get(), static_cast<short>(events), 0});
  }
}

void Server::accept_new() {
  for (;;) {
    Fd fd(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (!fd) return;
    if (clients_.size() >= kMaxClients && !make_room()) {
      const std::string busy = answer_line(nullptr, Refusal{"busy", "64 other clients wait for answers", "try again"});
      (void)::send(fd.get(), busy.data(), busy.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
      continue;
    }
    Client& client = clients_[next_client_++];
    client.fd = std::move(fd);
    client.heard_turn = turn_;
  }
}

bool Server::make_room() {
  auto silent = clients_.end();
  for (auto it = clients_.begin(); it != clients_.end(); ++it) {
    const Client& client = it->second;
    const bool waits = client.owed > 0 || client.behind || !client.out.empty();
    if (waits || client.heard_turn == turn_) continue;
    if (silent == clients_.end() || client.heard_turn < silent->second.heard_turn) silent = it;
  }
  if (silent == clients_.end()) return false;
  clients_.erase(silent);
  return true;
}

void Server::serve() {
  ++turn_;
  accept_new();
  for (auto it = clients_.begin(); it != clients_.end();) {
    Client& client = it->second;
    read_from(it->first, client);
    write_to(client);
    it = finished(client) ? clients_.erase(it) : std::next(it);
  }
}

bool Server::finished(const Client& client) {
  if (client.out.size() > kMaxUnreadBytes) return true;
  if (client.ended) {
    // A half-closed client (`nc -N`) still gets its answers; POLLHUP means it has left.
    pollfd state{client.fd.get(), 0, 0};
    ::poll(&state, 1, 0);
    return (state.revents & (POLLHUP | POLLERR)) != 0 || (client.owed == 0 && client.out.empty());
  }
  return client.closing && client.out.empty();
}

void Server::read_from(std::uint64_t key, Client& client) {
  char chunk[65536];
  // A bounded number of reads and requests per turn, so that one busy client does not starve the others.
  int left = kRequestsPerTurn;
  const auto handle_lines = [&] {
    while (left > 0 && !client.closing) {
      const auto line = client.in.next();
      if (!line) break;
      handle(key, client, *line);
      --left;
    }
    client.behind = left == 0;  // there may be more
  };
  handle_lines();
  for (int turn = 0; turn < 16 && left > 0 && !client.closing && !client.ended; ++turn) {
    const ssize_t got = ::recv(client.fd.get(), chunk, sizeof(chunk), 0);
    if (got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR)) {
      client.ended = true;
      return;
    }
    if (got < 0) return;
    client.heard_turn = turn_;
    client.in.feed({chunk, static_cast<std::size_t>(got)});
    handle_lines();
    if (!client.behind && client.in.too_long()) refuse_long(key, client);
  }
}

void Server::refuse_long(std::uint64_t key, Client& client) {
  reply({key, nullptr}, Refusal{"too_long", fmt::format("a request is at most {} bytes", kMaxRequestBytes),
                                "send the law's source without generated tables"});
  client.closing = true;
}

void Server::handle(std::uint64_t key, Client& client, const std::string& line) {
  if (line.size() > kMaxRequestBytes) return refuse_long(key, client);
  bool too_deep = false;
  const auto note_depth = [&too_deep](int depth, Json::parse_event_t, Json&) {
    too_deep = too_deep || depth > kMostNested;
    return !too_deep;
  };
  Json request;
  std::string no_json;
  try {
    request = Json::parse(line, note_depth);
  } catch (const Json::exception& error) {
    no_json = error.what();
    no_json = printable(no_json.substr(std::min(no_json.find("] ") + 2, no_json.size())).substr(0, kMostTold));
  }
  if (too_deep) {
    return reply({key, nullptr}, Refusal{"bad_request", fmt::format("a request is at most {} levels deep", kMostNested),
                                         "docs/reference/verbs.md lists the verbs and their arguments"});
  }
  if (!request.is_object() || !request.contains("verb") || !request["verb"].is_string()) {
    return reply(
        {key, request.is_object() ? request.value("id", Json(nullptr)) : Json(nullptr)},
        Refusal{"bad_request",
                "a request is one line of JSON: {\"id\":1,\"verb\":\"status\",\"args\":{}}" +
                    (no_json.empty() ? "" : "; this is none: " + no_json),
                no_json.empty() ? "docs/reference/verbs.md lists the verbs"
                                : "JSON has no NaN, no Infinity and no number beyond 1.8e308; its text is UTF-8"});
  }
  const ReplyTo to{key, request.value("id", Json(nullptr))};
  const Json args = request.value("args", Json::object());
  if (!args.is_object())
    return reply(to, Refusal{"bad_request", "args is a JSON object", "send {\"verb\":...,\"args\":{...}}"});
  const Json words = {{"verb", request["verb"]}, {"args", args}};
  if (const auto found = unprintable_in(words)) {
    return reply(to, Refusal{"bad_request", fmt::format("'{}' is not printable text", *found),
                             "names are UTF-8 without control characters, line ends and escapes"});
  }
  ++client.owed;
  try {
    handler_(to, request["verb"].get<std::string>(), args);
  } catch (const Json::exception& wrong) {
    reply(to, Refusal{"usage", fmt::format("an argument has the wrong type: {}", wrong.what()),
                      "compare with the verb's arguments in docs"});
  } catch (const std::exception& wrong) {
    reply(to, Refusal{"internal", fmt::format("the supervisor went wrong over this request: {}", wrong.what()),
                      "the robot goes on; lithe status shows whether the request took effect"});
  }
}

void Server::reply(const ReplyTo& to, const Answer& answer) {
  const auto found = clients_.find(to.client);
  if (found != clients_.end()) {
    Client& client = found->second;
    client.out += answer_line(to.id, answer);
    client.owed -= client.owed > 0 ? 1 : 0;
  }
}

void Server::write_to(Client& client) {
  while (!client.out.empty()) {
    const ssize_t sent = ::send(client.fd.get(), client.out.data(), client.out.size(), MSG_NOSIGNAL);
    if (sent > 0) {
      client.out.erase(0, static_cast<std::size_t>(sent));
    } else if (sent < 0 && errno == EINTR) {
      continue;
    } else if (sent < 0 && errno == EAGAIN) {
      return;
    } else {
      client.closing = true;
      client.out.clear();
    }
  }
}

void Server::flush(int timeout_ms) {
  for (auto& [key, client] : clients_) {
    write_to(client);
    if (!client.out.empty()) {
      pollfd wait{client.fd.get(), POLLOUT, 0};
      ::poll(&wait, 1, timeout_ms);
      write_to(client);
    }
  }
}

}  // namespace lithe::control
