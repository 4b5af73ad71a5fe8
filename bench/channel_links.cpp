// SPDX-License-Identifier: Apache-2.0
#include "bench/channel_links.hpp"

#include <fcntl.h>
#include <sys/socket.h>
#include <unistd.h>
#include <zmq.h>

#include <array>
#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "spine/ipc/channel.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::bench {
namespace {

template <std::size_t kWords>
struct Message {
  std::uint64_t sequence;
  std::uint64_t body[kWords - 1];
};
constexpr std::size_t kPeerWords = 32;  // 256 bytes, as the peers send
constexpr std::size_t kPlanWords = sizeof(wire::Plan) / sizeof(std::uint64_t);

[[noreturn]] void give_up(const char* what) {
  std::perror(what);
  std::exit(2);
}

// One or several cache lines with a sequence number and payload. Nothing protects them, so this is the best that the
// hardware can do. With kWords = 1 only the number is transferred.
template <std::size_t kWords>
class CacheLineLink final : public Link {
 public:
  explicit CacheLineLink(const char* name) : name_(name) {}
  const char* name() const override { return name_; }
  void send(int side, std::uint64_t sequence) override {
    Line& line = line_[static_cast<std::size_t>(side)];
    for (std::size_t i = 1; i < kWords; ++i) line.word[i].store(sequence, std::memory_order_relaxed);
    line.word[0].store(sequence, std::memory_order_release);
  }
  bool arrived(int side, std::uint64_t sequence) override {
    const Line& line = line_[static_cast<std::size_t>(1 - side)];
    if (line.word[0].load(std::memory_order_acquire) != sequence) return false;
    std::uint64_t sum = 0;
    for (std::size_t i = 1; i < kWords; ++i) sum += line.word[i].load(std::memory_order_relaxed);
    return sum == (kWords - 1) * sequence;
  }

 private:
  struct alignas(128) Line {
    std::array<std::atomic<std::uint64_t>, kWords> word{};
  };
  const char* name_;
  std::array<Line, 2> line_;
};

template <std::size_t kWords>
class ChannelLink final : public Link {
 public:
  explicit ChannelLink(const char* name) : name_(name) {}
  const char* name() const override { return name_; }
  void send(int side, std::uint64_t sequence) override {
    End& end = end_[static_cast<std::size_t>(side)];
    end.out.sequence = sequence;
    end.writer.write(end.out);
  }
  bool arrived(int side, std::uint64_t sequence) override {
    End& end = end_[static_cast<std::size_t>(side)];
    return end.reader.read(end.in) && end.in.sequence == sequence;
  }

 private:
  using Payload = Message<kWords>;
  struct alignas(128) End {
    End(ipc::ChannelMemory<Payload>& mine, ipc::ChannelMemory<Payload>& other) : writer(mine), reader(other) {}
    ipc::ChannelWriter<Payload> writer;
    ipc::ChannelReader<Payload> reader;
    Payload out{};
    Payload in{};
  };
  const char* name_;
  alignas(128) ipc::ChannelMemory<Payload> memory_[2]{};
  End end_[2]{{memory_[0], memory_[1]}, {memory_[1], memory_[0]}};
};

class UnixDatagramLink final : public Link {
 public:
  UnixDatagramLink() {
    if (socketpair(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0, socket_) != 0) give_up("socketpair");
  }
  ~UnixDatagramLink() override {
    close(socket_[0]);
    close(socket_[1]);
  }
  UnixDatagramLink(const UnixDatagramLink&) = delete;
  UnixDatagramLink& operator=(const UnixDatagramLink&) = delete;
  const char* name() const override { return "unix_datagram"; }
  void send(int side, std::uint64_t sequence) override {
    Message<kPeerWords> out{sequence, {}};
    if (::send(socket_[side], &out, sizeof out, 0) != sizeof out) give_up("send");
  }
  bool arrived(int side, std::uint64_t sequence) override {
    Message<kPeerWords> in;
    return ::recv(socket_[side], &in, sizeof in, 0) == sizeof in && in.sequence == sequence;
  }

 private:
  int socket_[2]{};
};

class ZeroMqLink final : public Link {
 public:
  ZeroMqLink() : path_("/tmp/lithe-bench-" + std::to_string(getpid())), context_(zmq_ctx_new()) {
    const std::string address = "ipc://" + path_;
    for (int side = 0; side < 2; ++side) socket_[side] = zmq_socket(context_, ZMQ_PAIR);
    if (zmq_bind(socket_[0], address.c_str()) != 0) give_up("zmq_bind");
    if (zmq_connect(socket_[1], address.c_str()) != 0) give_up("zmq_connect");
  }
  ~ZeroMqLink() override {
    zmq_close(socket_[0]);
    zmq_close(socket_[1]);
    zmq_ctx_term(context_);
    unlink(path_.c_str());
  }
  ZeroMqLink(const ZeroMqLink&) = delete;
  ZeroMqLink& operator=(const ZeroMqLink&) = delete;
  const char* name() const override { return "zeromq"; }
  void send(int side, std::uint64_t sequence) override {
    Message<kPeerWords> out{sequence, {}};
    if (zmq_send(socket_[side], &out, sizeof out, 0) != sizeof out) give_up("zmq_send");
  }
  bool arrived(int side, std::uint64_t sequence) override {
    Message<kPeerWords> in;
    return zmq_recv(socket_[side], &in, sizeof in, ZMQ_DONTWAIT) == sizeof in && in.sequence == sequence;
  }

 private:
  std::string path_;
  void* context_;
  void* socket_[2]{};
};

}  // namespace

std::unique_ptr<Link> make_cache_line_link() { return std::make_unique<CacheLineLink<8>>("cache_line"); }
std::unique_ptr<Link> make_one_word_link() { return std::make_unique<CacheLineLink<1>>("one_word"); }
std::unique_ptr<Link> make_channel_56_link() { return std::make_unique<ChannelLink<7>>("channel_56"); }
std::unique_ptr<Link> make_channel_256_link() { return std::make_unique<ChannelLink<kPeerWords>>("channel_256"); }
std::unique_ptr<Link> make_raw_plan_link() { return std::make_unique<CacheLineLink<kPlanWords>>("raw_plan"); }
std::unique_ptr<Link> make_channel_plan_link() { return std::make_unique<ChannelLink<kPlanWords>>("channel_plan"); }
std::unique_ptr<Link> make_unix_datagram_link() { return std::make_unique<UnixDatagramLink>(); }
std::unique_ptr<Link> make_zeromq_link() { return std::make_unique<ZeroMqLink>(); }

}  // namespace lithe::bench
