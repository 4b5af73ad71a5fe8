// SPDX-License-Identifier: Apache-2.0
// The world as another program meets it: through its terminals, on a clock that the test turns.
#include "sim/world.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <array>
#include <bit>
#include <cmath>
#include <filesystem>
#include <fstream>

#include "spine/robot/robot.hpp"

namespace lithe::simulator {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::string_view kQuery = "can send 8001 11001F01130D BF\n";

robot::RobotConfig arm() {
  robot::RobotConfig config;
  config.buses.resize(1);
  config.buses[0].name = "can0";
  config.devices.resize(1);
  config.devices[0].name = "drive";
  return config;
}

// Two links that hang on each other; the inner one is let go from the side.
robot::RobotConfig two_links() {
  robot::RobotConfig config = arm();
  config.plant.kind = robot::PlantKind::chain;
  config.devices.push_back(config.devices[0]);
  config.joints.resize(2);
  for (std::size_t i = 0; i < 2; ++i) {
    config.devices[i].id = static_cast<std::uint32_t>(i + 1);
    config.joints[i].device = i;
    robot::PlantConfig& link = config.joints[i].sim;
    link.length_m = 0.2;
    link.mass_kg = 0.3;
    link.center_m = 0.1;
    link.link_inertia_kg_m2 = 1e-3;
  }
  config.joints[0].sim.initial_position_rad = 0.5;
  return config;
}

// The position in an answer to a query of three floats from register 1 on.
float position_rev(const std::string& answer) {
  const std::size_t at = answer.find("2F01");
  if (at == std::string::npos || at + 12 > answer.size()) return std::nanf("");
  std::uint32_t bits = 0;
  for (std::size_t byte = 0; byte < 4; ++byte)
    bits |= static_cast<std::uint32_t>(std::stoul(answer.substr(at + 4 + 2 * byte, 2), nullptr, 16)) << 8 * byte;
  return std::bit_cast<float>(bits);
}

// A host with one terminal open, and the world it talks to.
class Scene {
 public:
  explicit Scene(const Options& options = {}, const robot::RobotConfig& config = arm()) {
    auto world = World::open(config, options, [this](const std::string& line) { told.push_back(line); });
    EXPECT_TRUE(world) << world.message();
    world_ = std::move(*world);
  }
  ~Scene() { hang_up(); }

  void dial() {
    fd_ = ::open(world_->ends()[0]->place().c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK);
    ASSERT_GE(fd_, 0);
    pass(2);
  }
  void hang_up() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }
  // What comes back within so many milliseconds of the world's time.
  std::string say(std::string_view text, int ms = 2) {
    EXPECT_EQ(::write(fd_, text.data(), text.size()), static_cast<ssize_t>(text.size()));
    pass(ms);
    std::string all;
    std::array<char, 4096> bytes{};
    for (ssize_t n = ::read(fd_, bytes.data(), bytes.size()); n > 0; n = ::read(fd_, bytes.data(), bytes.size()))
      all.append(bytes.data(), static_cast<std::size_t>(n));
    return all;
  }
  void write_only(std::string_view text) {
    EXPECT_EQ(::write(fd_, text.data(), text.size()), static_cast<ssize_t>(text.size()));
    pass(1);
  }
  void pass(int ms) {
    for (int i = 0; i < ms; ++i) {
      for (const auto& end : world_->ends()) {
        pollfd wait{end->poll_fd(), POLLIN, 0};
        if (end->poll_fd() >= 0 && ::poll(&wait, 1, 5) > 0) end->serve(now_ns_);
      }
      now_ns_ += kMs;
      world_->tick(now_ns_);
    }
  }
  Result<> order(std::string_view line) { return world_->handle(*parse_order(line), now_ns_); }

  std::vector<std::string> told;

 private:
  std::unique_ptr<World> world_;
  int fd_ = -1;
  std::int64_t now_ns_ = 1'000 * kMs;
};

TEST(World, TellsWhereEachBusIsAndAnswersThere) {
  Scene scene;
  ASSERT_EQ(scene.told.size(), 1U);
  EXPECT_EQ(scene.told[0].substr(0, 19), "can0 fdcanusb /dev/");
  scene.dial();
  const std::string answer = scene.say(kQuery);
  EXPECT_EQ(answer.substr(0, 13), "OK\r\nrcv 0100 ") << answer;
}

TEST(World, WhoeverComesNextMeetsAFreshAdapter) {
  Scene scene;
  scene.dial();
  EXPECT_EQ(scene.say("can off\n"), "OK\r\n");
  EXPECT_EQ(scene.say("can off\n"), "ERR already in BusOff\r\n");
  scene.hang_up();
  scene.pass(3);
  scene.dial();
  EXPECT_EQ(scene.say("can off\n"), "OK\r\n");
}

TEST(World, FaultsBeginAndEnd) {
  Scene scene;
  scene.dial();
  EXPECT_TRUE(scene.order(R"({"fault": "drop", "share": 1})"));
  EXPECT_EQ(scene.say(kQuery), "OK\r\n");
  EXPECT_TRUE(scene.order(R"({"fault": "drop", "share": 0})"));
  EXPECT_NE(scene.say(kQuery).find("rcv"), std::string::npos);
  EXPECT_TRUE(scene.order(R"({"fault": "bus_off", "for_s": 0.02})"));
  EXPECT_EQ(scene.say(kQuery).find("rcv"), std::string::npos);
  scene.pass(20);
  EXPECT_EQ(scene.say(kQuery).find("rcv"), std::string::npos) << "the wires are good, the adapter has given up";
  scene.say("can off\ncan on\n");
  EXPECT_NE(scene.say(kQuery).find("rcv"), std::string::npos);
  EXPECT_TRUE(scene.order(R"({"fault": "delay", "ms": 10, "after_s": 0.01})"));
  scene.pass(11);
  EXPECT_EQ(scene.say(kQuery, 5).find("rcv"), std::string::npos);
  EXPECT_NE(scene.say("", 12).find("rcv"), std::string::npos);
  EXPECT_TRUE(scene.order(R"({"fault": "clear"})"));
  EXPECT_NE(scene.say(kQuery).find("rcv"), std::string::npos);
}

TEST(World, AnUnpluggedTerminalComesBackAsAnotherAndTheLinkFollows) {
  const std::string folder = testing::TempDir() + "lithe-sim-" + std::to_string(::getpid());
  {
    Scene scene({.link_folder = folder});
    scene.dial();
    const std::string before = std::filesystem::read_symlink(folder + "/can0");
    EXPECT_TRUE(scene.order(R"({"fault": "unplug", "for_s": 0.05})"));
    EXPECT_EQ(scene.told.back(), "can0 fdcanusb unplugged");
    EXPECT_FALSE(std::filesystem::is_symlink(folder + "/can0")) << "its terminal may be anybody's by now";
    scene.pass(60);
    EXPECT_NE(scene.told.back().find("/dev/"), std::string::npos);
    EXPECT_EQ(scene.told.size(), 3U);
    scene.hang_up();
    scene.dial();
    EXPECT_NE(scene.say(kQuery).find("rcv"), std::string::npos);
    EXPECT_EQ("can0 fdcanusb " + std::filesystem::read_symlink(folder + "/can0").string(), scene.told.back());
  }
  EXPECT_FALSE(std::filesystem::exists(folder + "/can0"));
  std::filesystem::remove(folder);
}

TEST(World, ALinkThatAnotherProgramHasMadeSinceIsLeftAlone) {
  const std::string folder = testing::TempDir() + "lithe-sim-other-" + std::to_string(::getpid());
  {
    Scene scene({.link_folder = folder});
    std::filesystem::remove(folder + "/can0");
    std::filesystem::create_symlink("/dev/null", folder + "/can0");
    EXPECT_TRUE(scene.order(R"({"fault": "unplug", "for_s": 1000})"));
    EXPECT_EQ(std::filesystem::read_symlink(folder + "/can0"), "/dev/null");
  }
  EXPECT_EQ(std::filesystem::read_symlink(folder + "/can0"), "/dev/null");
  std::filesystem::remove_all(folder);
}

TEST(World, AFileInThePlaceOfALinkIsLeftAloneAndNamed) {
  const std::string folder = testing::TempDir() + "lithe-sim-file-" + std::to_string(::getpid());
  std::filesystem::create_directories(folder);
  std::ofstream(folder + "/can0") << "somebody's";
  const auto world = World::open(arm(), {.link_folder = folder}, [](const std::string&) {});
  ASSERT_FALSE(world);
  EXPECT_NE(world.message().find("/can0 is in the way"), std::string::npos) << world.message();
  EXPECT_EQ(std::filesystem::file_size(folder + "/can0"), 10U);
  std::filesystem::remove_all(folder);
}

TEST(World, APlugThatFailedIsTriedAgainAsAWhole) {
  const std::string folder = testing::TempDir() + "lithe-sim-late-" + std::to_string(::getpid());
  Scene scene({.link_folder = folder});
  EXPECT_TRUE(scene.order(R"({"fault": "unplug", "for_s": 0.01})"));
  std::filesystem::remove_all(folder);  // there is no place for the link
  scene.pass(20);
  EXPECT_EQ(scene.told.back(), "can0 fdcanusb unplugged");
  std::filesystem::create_directories(folder);
  scene.pass(2);
  EXPECT_NE(scene.told.back().find("/dev/"), std::string::npos);
  EXPECT_EQ("can0 fdcanusb " + std::filesystem::read_symlink(folder + "/can0").string(), scene.told.back());
  scene.dial();
  EXPECT_NE(scene.say(kQuery).find("rcv"), std::string::npos);
  std::filesystem::remove_all(folder);
}

// Nobody reads what it says: lines get lost, but none is cut.
TEST(World, AnAdapterThatNobodyReadsLosesWholeLines) {
  Scene scene;
  scene.dial();
  std::string all;
  for (int i = 0; i < 4'000; ++i) scene.write_only(kQuery);
  for (int i = 0; i < 100; ++i) all += scene.say("");
  std::size_t whole = 0;
  for (std::size_t end = 0; (end = all.find("\r\n")) != std::string::npos; all.erase(0, end + 2)) {
    const std::string line = all.substr(0, end);
    ASSERT_TRUE(line == "OK" || (line.starts_with("rcv 0100 2100") && line.ends_with(" x-1"))) << line;
    ++whole;
  }
  EXPECT_GT(whole, 100U);
  EXPECT_LT(whole, 7'990U) << "nothing was lost, so nothing was shown";
}

TEST(World, AGatewayAndAnImuHaveNoEncoderToLose) {
  for (const robot::DeviceKind kind : {robot::DeviceKind::gateway, robot::DeviceKind::imu}) {
    robot::RobotConfig config = arm();
    config.devices[0].kind = kind;
    auto world = World::open(config, {}, [](const std::string&) {});
    ASSERT_TRUE(world) << world.message();
    EXPECT_EQ((*world)->handle(*parse_order(R"({"fault": "encoder", "device": "drive"})"), 0).message(),
              "such a thing cannot happen to drive");
    EXPECT_EQ((*world)->handle(*parse_order(R"({"fault": "encoder", "device": "drive", "after_s": 1})"), 0).message(),
              "such a thing cannot happen to drive")
        << "and not only when it is due";
  }
}

TEST(World, JointsHangOnEachOtherWhereTheRobotFileSaysSo) {
  Scene scene({}, two_links());
  scene.dial();
  const auto ask = [&](int id) {
    return position_rev(scene.say("can send 800" + std::to_string(id) + " 11001F01130D BF\n"));
  };
  EXPECT_GT(ask(1), 0.05F);
  scene.pass(300);
  EXPECT_GT(std::abs(ask(2)), 0.01F) << "nobody but the inner link could have moved it";
}

TEST(World, AModelThatCannotBeHadIsRefusedWithTheReason) {
  robot::RobotConfig config = two_links();
  config.plant.kind = robot::PlantKind::mujoco;
  config.plant.model = "/nowhere/leg.xml";
  const auto world = World::open(config, {}, [](const std::string&) {});
  EXPECT_NE(world.message().find("[plant] model: "), std::string::npos) << world.message();
}

TEST(World, RefusesWhatIsNotThere) {
  Scene scene;
  EXPECT_NE(scene.order(R"({"fault": "unplug", "bus": "can9"})").message().find("no bus 'can9'"), std::string::npos);
  EXPECT_NE(scene.order(R"({"fault": "reset", "device": "x"})").message().find("no device 'x'"), std::string::npos);
}

}  // namespace
}  // namespace lithe::simulator
