// SPDX-License-Identifier: Apache-2.0
#include "supervisor/serve/server.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>

#include <atomic>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <thread>

#include "supervisor/link/client/client.hpp"

namespace lithe::control {
namespace {

constexpr int kLongMs = 60'000;  // nobody waits for it: every answer comes

// A server that echoes its arguments, served by a thread of its own as `lithe run` would.
class ServerTest : public testing::Test {
 protected:
  ServerTest()
      : path_("/tmp/lithe-server-" + std::to_string(::getpid()) + "-" +
              testing::UnitTest::GetInstance()->current_test_info()->name()) {
    auto server = Server::listen(path_, [this](const ReplyTo& to, const std::string& verb, const Json& args) {
      if (verb == "later")
        waiting_.push_back(to);
      else if (verb == "throws")
        throw std::runtime_error("no such luck");
      else if (verb == "typed")
        server_->reply(to, Json{{"n", args.value("n", 1)}});
      else
        server_->reply(to, Json{{"verb", verb}, {"args", args}});
    });
    EXPECT_TRUE(server) << server.message();
    server_.emplace(std::move(*server));
    thread_ = std::thread([this] {
      while (!stop_) {
        std::vector<pollfd> fds;
        server_->add_poll_fds(fds);
        ::poll(fds.data(), fds.size(), 5);
        server_->serve();
        if (answer_later_.exchange(false)) {
          for (const ReplyTo& to : waiting_) server_->reply(to, Json{{"late", true}});
          server_->serve();
        }
      }
    });
  }
  ~ServerTest() override {
    stop_ = true;
    thread_.join();
  }

  Fd raw() const {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path_.c_str(), sizeof(address.sun_path) - 1);
    Fd fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    EXPECT_EQ(::connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    return fd;
  }
  static Json line_from(const Fd& fd) {
    std::string text;
    char byte = 0;
    while (::recv(fd.get(), &byte, 1, 0) == 1 && byte != '\n') text += byte;
    return Json::parse(text, nullptr, false);
  }
  static void send(const Fd& fd, const std::string& text) {
    std::size_t sent = 0;
    while (sent < text.size()) {
      const ssize_t n = ::send(fd.get(), text.data() + sent, text.size() - sent, MSG_NOSIGNAL);
      if (n <= 0) return;
      sent += static_cast<std::size_t>(n);
    }
  }

  std::string path_;
  std::optional<Server> server_;
  std::vector<ReplyTo> waiting_;
  std::atomic<bool> stop_{false};
  std::atomic<bool> answer_later_{false};
  std::thread thread_;
};

TEST_F(ServerTest, AnswersARequestWithItsId) {
  auto client = Client::connect(path_);
  ASSERT_TRUE(client);
  const Answer answer = client->call("echo", {{"x", 1}}, kLongMs);
  ASSERT_TRUE(std::holds_alternative<Json>(answer));
  EXPECT_EQ(std::get<Json>(answer)["args"]["x"], 1);
}

TEST_F(ServerTest, AnswersGarbageWithAnErrorAndGoesOn) {
  const Fd fd = raw();
  for (const char* garbage :
       {"}{\n", "\n", "[1,2]\n", "{\"verb\":7}\n", "\xff\xfe\n", "{\"verb\":\"echo\",\"args\":3}\n"}) {
    send(fd, garbage);
    const Json answer = line_from(fd);
    EXPECT_EQ(answer["ok"], false) << garbage;
    EXPECT_EQ(answer["error"]["code"], "bad_request") << garbage;
  }
  send(fd, "{\"id\":5,\"verb\":\"echo\"}\n");
  EXPECT_EQ(line_from(fd)["id"], 5);
}

TEST_F(ServerTest, SaysWhereARequestIsNoJson) {
  const Fd fd = raw();
  for (const auto& [value, told] : {std::pair("NaN", "invalid literal"),
                                    {"1e400", "number overflow parsing '1e400'"},
                                    {"\"\xff\"", "ill-formed UTF-8 byte"},
                                    {"", "syntax error"}}) {
    send(fd, std::string("{\"id\":1,\"verb\":\"echo\",\"args\":{\"v\":") + value + "}}\n");
    const Json error = line_from(fd)["error"];
    EXPECT_NE(error["message"].get<std::string>().find("this is none: "), std::string::npos) << error;
    EXPECT_NE(error["message"].get<std::string>().find(told), std::string::npos) << error;
    EXPECT_NE(error["next"].get<std::string>().find("no NaN"), std::string::npos) << error;
  }
}

// Wherever a client may put a word. The source of a law has its own rules.
TEST_F(ServerTest, WordsThatAreNotPrintableAreRefusedAndShownHarmlessly) {
  const Fd fd = raw();
  for (const char* bad : {"\\u001b[2J", "\\n", "\\u0000", "\\u007f", "\\u009b", "\\u202e", "\\u200b", "\\ufeff"}) {
    const std::string word = std::string("\"a") + bad + "\"";
    for (const std::string& request :
         {"{\"id\":1,\"verb\":" + word + "}", "{\"id\":1,\"verb\":\"echo\",\"args\":{\"name\":" + word + "}}",
          "{\"id\":1,\"verb\":\"echo\",\"args\":{\"values\":{" + word + ":1}}}",
          "{\"id\":1,\"verb\":\"echo\",\"args\":{\"fields\":[1," + word + "]}}"}) {
      send(fd, request + "\n");
      const Json answer = line_from(fd);
      ASSERT_EQ(answer["ok"], false) << request;
      EXPECT_EQ(answer["error"]["code"], "bad_request") << request;
      EXPECT_TRUE(is_printable(answer["error"]["message"].get<std::string>()));
    }
    send(fd, "{\"id\":1,\"verb\":\"echo\",\"args\":{\"source\":" + word + "}}\n");
    EXPECT_EQ(line_from(fd)["ok"], true);
  }
  for (const char* raw_bytes : {"\xff", "\xc0\xaf", "\xed\xa0\x80", "\x1b"}) {
    send(fd, std::string("{\"verb\":\"echo\",\"args\":{\"name\":\"") + raw_bytes + "\"}}\n");
    EXPECT_EQ(line_from(fd)["error"]["code"], "bad_request") << "no JSON at all";
  }
  send(fd,
       "{\"id\":1,\"verb\":\"echo\",\"args\":{\"name\":\"R\xc3\xbc"
       "ck.cpp\"}}\n");
  EXPECT_EQ(line_from(fd)["ok"], true);
}

TEST_F(ServerTest, ARequestThatIsNestedWithoutEndIsRefused) {
  const Fd fd = raw();
  const std::string deep = std::string(400'000, '[') + std::string(400'000, ']');
  send(fd, "{\"id\":" + deep + ",\"verb\":\"echo\"}\n");
  EXPECT_EQ(line_from(fd)["error"]["code"], "bad_request");
  send(fd, "{\"verb\":\"echo\",\"args\":{\"x\":" + deep + "}}\n");
  EXPECT_EQ(line_from(fd)["error"]["code"], "bad_request");
  send(fd, "{\"id\":5,\"verb\":\"echo\",\"args\":{\"x\":[[[[1]]]]}}\n");
  EXPECT_EQ(line_from(fd)["id"], 5);
}

TEST_F(ServerTest, AnArgumentOfTheWrongTypeIsAUsageError) {
  const Fd fd = raw();
  send(fd, "{\"id\":1,\"verb\":\"typed\",\"args\":{\"n\":\"three\"}}\n");
  EXPECT_EQ(line_from(fd)["error"]["code"], "usage");
}

TEST_F(ServerTest, AnExceptionInAVerbIsAnsweredAndTheOthersGoOn) {
  auto client = Client::connect(path_);
  const Answer answer = client->call("throws", Json::object(), kLongMs);
  ASSERT_TRUE(std::holds_alternative<Refusal>(answer));
  EXPECT_EQ(std::get<Refusal>(answer).code, "internal");
  EXPECT_NE(std::get<Refusal>(answer).message.find("no such luck"), std::string::npos);
  EXPECT_TRUE(std::holds_alternative<Json>(client->call("echo", Json::object(), kLongMs)));
}

TEST_F(ServerTest, RefusesARequestOverOneMebibyteAndOnlyItsSenderIsCutOff) {
  auto other = Client::connect(path_);
  const Fd fd = raw();
  send(fd, "{\"verb\":\"echo\",\"args\":{\"source\":\"" + std::string(kMaxRequestBytes, 'x'));
  EXPECT_EQ(line_from(fd)["error"]["code"], "too_long");
  char byte = 0;
  EXPECT_LE(::recv(fd.get(), &byte, 1, 0), 0);
  EXPECT_TRUE(std::holds_alternative<Json>(other->call("echo", Json::object(), kLongMs)));
}

TEST_F(ServerTest, AClientThatLeavesBeforeItsAnswerHarmsNobody) {
  {
    const Fd fd = raw();
    send(fd, "{\"id\":1,\"verb\":\"later\"}\n{\"id\":2,\"verb\":\"echo\"}\n");
    line_from(fd);
  }
  answer_later_ = true;
  auto other = Client::connect(path_);
  EXPECT_TRUE(std::holds_alternative<Json>(other->call("echo", Json::object(), kLongMs)));
}

TEST_F(ServerTest, AClientThatSendsNoMoreStillGetsItsAnswer) {
  const Fd fd = raw();
  send(fd, "{\"id\":1,\"verb\":\"later\"}\n{\"id\":2,\"verb\":\"echo\"}\n");
  EXPECT_EQ(line_from(fd)["id"], 2);
  ::shutdown(fd.get(), SHUT_WR);
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  answer_later_ = true;
  EXPECT_EQ(line_from(fd)["result"]["late"], true);
}

// What one client asks at once must not keep the supervisor from its heartbeat and its other clients.
TEST_F(ServerTest, AFloodOfOneClientIsHandledInPieces) {
  stop_ = true;
  thread_.join();
  const Fd flood = raw();
  const Fd other = raw();
  constexpr std::size_t kRequests = 1000;
  std::string text;
  for (std::size_t i = 0; i < kRequests; ++i) text += "{\"id\":1,\"verb\":\"later\"}\n";
  send(flood, text);
  send(other, "{\"id\":2,\"verb\":\"later\"}\n");
  server_->serve();
  EXPECT_LT(waiting_.size(), kRequests / 10) << "handled in one turn";
  EXPECT_EQ(waiting_.back().id, 2) << "the other client is served in the same turn";
  for (std::size_t turn = 0; turn < kRequests; ++turn) server_->serve();
  EXPECT_EQ(waiting_.size(), kRequests + 1);
  thread_ = std::thread([] {});
}

TEST_F(ServerTest, SilentClientsLockNobodyOut) {
  const Fd patient = raw();
  send(patient, "{\"id\":7,\"verb\":\"later\",\"args\":{}}\n");
  std::vector<Fd> silent;
  for (std::size_t i = 0; i < 2 * Server::kMaxClients; ++i) {
    silent.push_back(raw());
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  const Fd operating = raw();
  send(operating, "{\"id\":1,\"verb\":\"disarm\",\"args\":{}}\n");
  EXPECT_EQ(line_from(operating).value("id", 0), 1);
  answer_later_ = true;
  EXPECT_EQ(line_from(patient).value("id", 0), 7) << "who waits for an answer keeps its place";
}

TEST_F(ServerTest, TheSocketIsForOwnerAndGroupAlone) {
  struct stat status{};
  ASSERT_EQ(::stat(path_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0660U);
}

TEST(ServerFile, ReplacesAStaleSocketAndRemovesItsOwn) {
  const std::string path = "/tmp/lithe-stale-" + std::to_string(::getpid());
  ::close(::open(path.c_str(), O_CREAT | O_WRONLY, 0600));
  {
    auto server = Server::listen(path, [](const ReplyTo&, const std::string&, const Json&) {});
    ASSERT_TRUE(server) << server.message();
    EXPECT_TRUE(Client::connect(path));
  }
  EXPECT_FALSE(std::filesystem::exists(path));
}

TEST(ServerFile, SaysWhenThePathIsTooLong) {
  const auto server = Server::listen("/tmp/" + std::string(200, 'x'), {});
  ASSERT_FALSE(server);
  EXPECT_NE(server.message().find("LITHE_RUN_DIR"), std::string::npos);
}

}  // namespace
}  // namespace lithe::control
