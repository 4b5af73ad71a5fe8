// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/client/client.hpp"

#include <gtest/gtest.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "spine/core/host/paths.hpp"
#include "spine/ipc/segment.hpp"

namespace lithe::control {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;
using Control = ipc::Segment<ipc::ControlMemory>;

class PresenceTest : public ::testing::Test {
 protected:
  void SetUp() override {
    char folder[] = "/tmp/lithe_presence_XXXXXX";
    folder_ = mkdtemp(folder);
    setenv("LITHE_RUN_DIR", folder_.c_str(), 1);
    setenv("LITHE_SHM_PREFIX", ("presence-" + std::to_string(getpid())).c_str(), 1);
  }
  void TearDown() override {
    if (child_ > 0) {
      kill(child_, SIGKILL);
      waitpid(child_, nullptr, 0);
    }
    for (const std::string& path : {Spine::path("arm"), Control::path("arm")}) {
      std::filesystem::remove(path);
      std::filesystem::remove(path + ".lock");
    }
    std::filesystem::remove_all(folder_);
  }

  // A supervisor of a kind: listens, and never answers.
  void start_deaf_supervisor() {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strcpy(address.sun_path, control_socket_path("arm").c_str());
    int ready[2];
    ASSERT_EQ(pipe(ready), 0);
    child_ = fork();
    if (child_ == 0) {
      const int listener = socket(AF_UNIX, SOCK_STREAM, 0);
      const auto* where = reinterpret_cast<const sockaddr*>(&address);
      const bool up = bind(listener, where, sizeof(address)) == 0 && listen(listener, 1) == 0;
      (void)!write(ready[1], up ? "y" : "n", 1);
      for (;;) pause();
    }
    char said = 'n';
    ASSERT_EQ(read(ready[0], &said, 1), 1);
    close(ready[0]);
    close(ready[1]);
    ASSERT_EQ(said, 'y');
  }
  static std::string refused(const char* code) {
    const auto answer = reach("arm");
    const auto* refusal = std::get_if<Refusal>(&answer);
    if (refusal == nullptr) return "";
    EXPECT_EQ(refusal->code, code);
    EXPECT_TRUE(is_unreachable(*refusal));
    return refusal->message + "; next: " + refusal->next;
  }

  std::string folder_;
  pid_t child_ = 0;
};

TEST_F(PresenceTest, ARobotThatIsNotThereIsUnreachable) {
  EXPECT_FALSE(look_for("arm").is_there());
  EXPECT_NE(refused("no_robot").find("no robot 'arm' is running here"), std::string::npos);
}

TEST_F(PresenceTest, ASpineWithoutASupervisorIsNamedWithTheWayToAdoptIt) {
  const auto lease = ipc::Lease::try_take(Spine::path("arm"));
  ASSERT_TRUE(lease && lease->has_value());
  const auto spine = Spine::create("arm");
  ASSERT_TRUE(spine);
  ipc::sign_in((*spine)->header, 1);
  const std::string said = refused("no_supervisor");
  EXPECT_NE(said.find("robot 'arm' has no supervisor, and its Spine (pid " + std::to_string(getpid()) +
                      ") lives but does not tick"),
            std::string::npos)
      << said;
  EXPECT_NE(said.find("take it over, as it is: lithe run ROBOT.toml"), std::string::npos) << said;
  EXPECT_NE(said.find("lithe estop"), std::string::npos) << said;
}

TEST_F(PresenceTest, ASupervisorThatIsStoppedIsNotWaitedFor) {
  start_deaf_supervisor();
  ASSERT_EQ(kill(child_, SIGSTOP), 0);
  int status = 0;
  ASSERT_EQ(waitpid(child_, &status, WUNTRACED), child_);
  const std::string said = refused("no_answer");
  EXPECT_NE(said.find("is stopped (Ctrl-Z?), and nothing was asked of it"), std::string::npos) << said;
  EXPECT_NE(said.find("kill -CONT " + std::to_string(child_)), std::string::npos) << said;
}

TEST_F(PresenceTest, ASupervisorThatSleepsOnIsSilent) {
  start_deaf_supervisor();
  EXPECT_NE(refused("no_answer").find("does not answer, and nothing was asked of it"), std::string::npos);
}

// As many clients as it lets wait have come before.
TEST_F(PresenceTest, AFullQueueIsNotTakenForNobody) {
  start_deaf_supervisor();
  const auto lease = ipc::Lease::try_take(Control::path("arm"));
  ASSERT_TRUE(lease && lease->has_value());
  std::vector<Client> clients;
  for (;;) {
    auto client = Client::connect(control_socket_path("arm"));
    if (!client) {
      EXPECT_TRUE(Client::is_full(client)) << client.message();
      break;
    }
    clients.push_back(std::move(*client));
    ASSERT_LT(clients.size(), 100u);
  }
  EXPECT_NE(refused("no_answer").find("does not answer"), std::string::npos);
  EXPECT_EQ(running_robots(), std::vector<std::string>{"arm"});
}

TEST_F(PresenceTest, ASupervisorWithoutASocketIsStarting) {
  const auto lease = ipc::Lease::try_take(Control::path("arm"));
  ASSERT_TRUE(lease && lease->has_value());
  EXPECT_NE(refused("starting").find("takes no commands"), std::string::npos);
}

// A question is answered or not; only a command may still take effect.
TEST_F(PresenceTest, AQuestionNeverMayStillTakeEffect) {
  start_deaf_supervisor();
  auto client = Client::connect(control_socket_path("arm"));
  ASSERT_TRUE(client);
  for (const char* verb : {"status", "events", "params", "law_list", "arm"}) {
    const Answer answer = client->call(verb, Json::object(), 10);
    const auto* refusal = std::get_if<Refusal>(&answer);
    ASSERT_NE(refusal, nullptr);
    EXPECT_EQ(refusal->code, "timeout");
    const bool may = refusal->message.find("may still take effect") != std::string::npos;
    EXPECT_EQ(may, std::string(verb) == "arm") << refusal->message;
  }
}

}  // namespace
}  // namespace lithe::control
