// SPDX-License-Identifier: Apache-2.0
// The control socket: JSON lines over a Unix stream. No client can block it or fill its memory.
#pragma once

#include <poll.h>

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "spine/core/host/fd.hpp"
#include "spine/core/result.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/core/lines.hpp"

namespace lithe::control {

// The address of an answer. When the client has left, the answer is dropped without an error.
struct ReplyTo {
  std::uint64_t client = 0;
  Json id = nullptr;
};

// Contract: one thread · never blocks · an invalid request gets an error answer; a client that sends a line of more
// than 1 MiB, or does not read its answers, is disconnected, and so is the one silent longest when a 65th comes; other
// clients are not affected
class Server {
 public:
  using Handler = std::function<void(const ReplyTo&, const std::string& verb, const Json& args)>;
  static constexpr std::size_t kMaxClients = 64;
  static constexpr std::size_t kMaxUnreadBytes = std::size_t{16} << 20;

  // Removes a stale socket file first: the caller holds the robot's lock, so nobody listens there.
  static Result<Server> listen(const std::string& path, Handler handler);
  // False: its file was removed, or replaced, so that no new client finds it. Those that are connected go on.
  bool is_there() const;
  Result<> listen_again();

  void add_poll_fds(std::vector<pollfd>& fds) const;
  // Accepts clients, reads, calls the handler for each complete request, writes pending answers. Call after poll().
  void serve();
  void reply(const ReplyTo& to, const Answer& answer);
  // Writes pending answers for up to `timeout_ms`.
  void flush(int timeout_ms);

  Server(Server&& other) noexcept;
  Server& operator=(Server&&) = delete;
  ~Server();

 private:
  struct Client {
    Fd fd;
    LineBuffer in;
    std::string out;
    std::size_t owed = 0;          // requests not answered yet
    bool ended = false;            // half closed: sends no more, may still wait for answers
    bool behind = false;           // requests that were read are left for the next turn
    bool closing = false;          // close once `out` is written
    std::uint64_t heard_turn = 0;  // of serve(), when it last sent something
  };

  Server(std::string path, Handler handler);
  void accept_new();
  // Makes room for one more: ends the client that has been silent longest and waits for no answer.
  bool make_room();
  void read_from(std::uint64_t key, Client& client);
  void refuse_long(std::uint64_t key, Client& client);
  void handle(std::uint64_t key, Client& client, const std::string& line);
  static void write_to(Client& client);
  static bool finished(const Client& client);

  Fd listener_;
  std::uint64_t file_ = 0;  // inode of the socket's file
  std::string path_;
  Handler handler_;
  std::map<std::uint64_t, Client> clients_;
  std::uint64_t next_client_ = 1, turn_ = 0;
};

}  // namespace lithe::control
