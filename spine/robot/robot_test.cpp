// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/robot.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>
#include <sstream>

#include "spine/core/joints.hpp"
#include "spine/core/text.hpp"
#include "spine/robot/values.hpp"

namespace lithe::robot {
namespace {

// The smallest robot; every other test damages or extends it.
const std::string kSmallest = R"(name = "r"
[[bus]]
name = "can0"
kind = "loop"
[[device]]
name = "d0"
kind = "moteus"
bus = "can0"
id = 1
[[joint]]
name = "j0"
device = "d0"
position_min_rad = -1.0
position_max_rad = 1
velocity_max_rad_s = 10.0
torque_max_nm = 1.0
torque_slew_nm_s = 100.0
safe_kd_nm_s_rad = 0.1
)";

std::string replaced(const std::string& from, const std::string& to) {
  std::string text = kSmallest;
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

// The message for an invalid file; it must have `place` (line:column) and every phrase.
void expect_refused(const std::string& text, const std::string& place, const std::vector<std::string>& phrases) {
  const Result<RobotConfig> robot = parse_robot(text, "r.toml");
  ASSERT_FALSE(robot) << "accepted, but should say: " << phrases.front();
  EXPECT_NE(robot.message().find("r.toml:" + place + (place.ends_with(":") ? "" : ": ")), std::string::npos)
      << robot.message();
  for (const std::string& phrase : phrases)
    EXPECT_NE(robot.message().find(phrase), std::string::npos) << robot.message() << "\nlacks: " << phrase;
}

TEST(Robot, AMistakeInOneLimitIsNoMistakeInTheOther) {
  const Result<RobotConfig> robot =
      parse_robot(replaced("position_max_rad = 1\n", "position_max_rad = \"1\"\n"), "r.toml");
  ASSERT_FALSE(robot);
  EXPECT_EQ(robot.message().find('\n'), std::string::npos) << robot.message();
  expect_refused(replaced("position_max_rad = 1\n", "position_max_rad = -2\n"), "14:20",
                 {"-2 is not above position_min_rad = -1"});
}

TEST(Robot, TheDeskArmLoadsAsItIsWritten) {
  const Result<RobotConfig> arm = load_robot(LITHE_ROBOTS "/arm.toml");
  ASSERT_TRUE(arm) << arm.message();
  EXPECT_EQ(arm->name, "arm");
  EXPECT_EQ(arm->rate_hz, 1000.0);
  EXPECT_TRUE(arm->law.ends_with("/laws/pd.cpp") && arm->law.starts_with("/")) << arm->law;
  ASSERT_EQ(arm->joints.size(), 1U);
  EXPECT_EQ(arm->joints[0].sim.mgl_nm, 0.165);
  EXPECT_EQ(arm->joints[0].sim.encoder_counts, 16384U);
  EXPECT_EQ(arm->devices[arm->joints[0].device].watchdog_s, 0.2);
  EXPECT_TRUE(arm->notes.empty()) << arm->notes.front();
}

TEST(Robot, EveryRobotOfTheHouseLoads) {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(LITHE_ROBOTS)) {
    if (entry.path().extension() != ".toml") continue;
    const Result<RobotConfig> robot = load_robot(entry.path().string());
    EXPECT_TRUE(robot) << robot.message();
    ++count;
  }
  EXPECT_GE(count, 3);
}

TEST(Robot, TheSmallestFileGetsTheDocumentedDefaults) {
  const Result<RobotConfig> robot = parse_robot(kSmallest, "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  EXPECT_EQ(robot->rate_hz, 1000.0);
  EXPECT_EQ(robot->law, "");
  EXPECT_EQ(robot->spine.release, Release::spin);
  EXPECT_EQ(robot->spine.cpu_spine, kAutoCpu);
  EXPECT_EQ(robot->spine.phase_ns, 500'000);
  EXPECT_EQ(robot->joints[0].position_max_rad, 1.0);
  EXPECT_EQ(robot->joints[0].kp_max_nm_rad, 100.0);
}

TEST(Robot, AWrongKeyIsNamedWithItsPlaceAndTheNearestRightOne) {
  expect_refused(replaced("torque_max_nm", "torque_max_mn"), "16:1",
                 {"[[joint]] j0", "'torque_max_mn' is no key", "did you mean 'torque_max_nm'?"});
  expect_refused("rate_Hz = 1000\n" + kSmallest, "1:1", {"'rate_Hz'", "did you mean 'rate_hz'?"});
  expect_refused(kSmallest + "[joint.sim]\nmass = 1\n", "20:1",
                 {"[[joint]] j0.sim", "'mass' is no key", "inertia_kg_m2"});
  expect_refused(kSmallest + "[spine]\nrelese = \"spin\"\n", "20:1", {"[spine]", "did you mean 'release'?"});
  expect_refused(kSmallest + "[gaurd]\n", "19:2", {"did you mean 'guard'?"});
}

// Together they have every key of robot, drive, joint and sensor; those of real buses are in hardware_test.cpp.
class RobotFile : public ::testing::TestWithParam<const char*> {
 protected:
  RobotFile() {
    std::ifstream file(std::string(LITHE_ROBOTS) + "/" + GetParam());
    for (std::string line; std::getline(file, line);) lines.push_back(line);
  }
  std::vector<std::string> lines;
};

INSTANTIATE_TEST_SUITE_P(AtHand, RobotFile, ::testing::Values("arm.toml", "frankenstein.toml"));

TEST_P(RobotFile, EveryKeyOfEverySectionIsRefusedWhenMisspelt) {
  int keys = 0;
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const std::size_t end = lines[i].find(" = ");
    if (end == std::string::npos || lines[i].starts_with("#")) continue;
    std::string text;
    for (std::size_t k = 0; k < lines.size(); ++k) text += (k == i ? "z" + lines[k] : lines[k]) + "\n";
    expect_refused(text, std::to_string(i + 1) + ":1", {"'z" + lines[i].substr(0, end) + "' is no key"});
    ++keys;
  }
  EXPECT_GT(keys, 45);
}

TEST_P(RobotFile, EveryKeyOfEverySectionIsRefusedWithTheWrongType) {
  for (std::size_t i = 0; i < lines.size(); ++i) {
    const std::size_t end = lines[i].find(" = ");
    if (end == std::string::npos || lines[i].starts_with("#")) continue;
    std::string text;
    const std::string broken = lines[i].substr(0, end) + " = 1979-05-27";
    for (std::size_t k = 0; k < lines.size(); ++k) text += (k == i ? broken : lines[k]) + "\n";
    expect_refused(text, std::to_string(i + 1) + ":" + std::to_string(end + 4), {"this is a date or time; give "});
  }
}

TEST(Robot, AWrongTypeSaysWhatToGive) {
  expect_refused(replaced("id = 1", "id = \"1\""), "9:6", {"this is a string; give an integer from 1 to 126"});
  expect_refused(replaced("id = 1", "id = 1.5"), "9:6", {"this is a number with a fraction"});
  expect_refused("rate_hz = \"1kHz\"\n" + kSmallest, "1:11", {"rate_hz: this is a string; give a number from 100"});
  expect_refused(replaced("[[bus]]", "[bus]"), "2:1", {"write [[bus]] before each"});
  expect_refused(kSmallest + "[[spine]]\n", "19:1", {"write [spine]"});
}

TEST(Robot, AnImpossibleRateIsRefusedWithTheRange) {
  for (const char* rate : {"0", "-1000", "99", "10001", "1e12", "nan", "inf"})
    expect_refused("rate_hz = " + std::string(rate) + "\n" + kSmallest, "1:11", {"give a number from 100 to 10000"});
}

TEST(Robot, AValueThatIsNotANumberIsNeverTaken) {
  expect_refused(replaced("torque_max_nm = 1.0", "torque_max_nm = nan"), "16:17", {"nan will not do"});
  expect_refused(replaced("torque_max_nm = 1.0", "torque_max_nm = -0.5"), "16:17", {"-0.5 will not do"});
  expect_refused(replaced("velocity_max_rad_s = 10.0", "velocity_max_rad_s = inf"), "15:22", {"inf will not do"});
}

TEST(Robot, AMissingKeyIsReportedWhereItBelongs) {
  expect_refused(replaced("torque_max_nm = 1.0\n", ""), "10:1",
                 {"torque_max_nm is missing; add `torque_max_nm = ...`"});
  expect_refused(replaced("name = \"r\"\n", ""), "1:1", {"name is missing"});
  expect_refused("name = \"r\"\n", "1:1", {"there is no [[bus]]", "there is no [[device]]", "there is no [[joint]]"});
  expect_refused("", "1:1", {"name is missing"});
}

TEST(Robot, UnknownReferencesNameTheNearestRightOne) {
  expect_refused(replaced("bus = \"can0\"", "bus = \"cna0\""), "8:7", {"no [[bus]] named \"cna0\"", "'can0'"});
  expect_refused(replaced("device = \"d0\"", "device = \"d1\""), "12:10", {"no [[device]] named \"d1\"", "'d0'"});
  expect_refused(replaced("device = \"d0\"", "device = \"left_knee\""), "12:10", {"one of: d0"});
}

TEST(Robot, AnUnknownWordListsTheKnownOnes) {
  expect_refused(replaced("kind = \"moteus\"", "kind = \"motues\""), "7:8", {"did you mean \"moteus\"?"});
  expect_refused(kSmallest + "[spine]\nrelease = \"busy\"\n", "20:11", {"\"spin\", \"hybrid\", \"sleep\""});
}

std::string values(const std::string& text) {
  const Result<RobotConfig> robot = parse_robot(text, "/robots/r.toml");
  EXPECT_TRUE(robot) << robot.message();
  return robot ? robot->values : "";
}

TEST(Robot, WaysToWriteTheSameRobotHaveTheSameValues) {
  const std::string plain = values(kSmallest);
  EXPECT_EQ(values("# a comment\n" + kSmallest), plain);
  EXPECT_EQ(values("\xEF\xBB\xBF" + kSmallest), plain) << "a byte order mark";
  EXPECT_EQ(values(replaced("position_max_rad = 1\n", "position_max_rad = 1.0\n")), plain);
  EXPECT_EQ(values(kSmallest + "[joint.sim]\nseed = 1\n"), plain) << "a default that is written";
  EXPECT_EQ(values(kSmallest + "[guard]\nsoft_start_s = 0.5\n"), plain);
  EXPECT_EQ(values(replaced("torque_max_nm = 1.0\n", "") + "[defaults.joint]\ntorque_max_nm = 1.0\n"), plain);
  EXPECT_EQ(values("law = \"other.cpp\"\n" + kSmallest), plain) << "the law to start with is not the robot";
}

// Every key of every robot file at hand: another value is another robot, and the difference names the key.
TEST(Robot, EachKeyChangesTheValues) {
  std::size_t keys = 0;
  for (const auto& file : std::filesystem::directory_iterator(LITHE_ROBOTS)) {
    if (file.path().extension() != ".toml") continue;
    const Result<RobotConfig> robot = load_robot(file.path());
    ASSERT_TRUE(robot) << robot.message();
    std::istringstream lines(robot->values);
    for (std::string line; std::getline(lines, line); ++keys) {
      std::string other = robot->values;
      other.replace(other.find(line + '\n') + line.size(), 0, "1");
      EXPECT_NE(values_hash(other), values_hash(robot->values)) << line;
      EXPECT_EQ(values_difference(robot->values, other),
                "  " + line + ", and there " + line.substr(line.find(" = ") + 3) + "1\n");
    }
  }
  EXPECT_GT(keys, 1000U);
}

TEST(Robot, AnotherLimitIsNamed) {
  const std::string tighter = values(replaced("torque_max_nm = 1.0", "torque_max_nm = 0.3"));
  EXPECT_EQ(values_difference(tighter, values(kSmallest)), "  [[joint]] j0: torque_max_nm = 0.3, and there 1\n");
  EXPECT_NE(values(kSmallest + "[joint.sim]\nseed = 2\n"), values(kSmallest));
  EXPECT_NE(values(kSmallest + "[guard]\nsoft_start_s = 1\n"), values(kSmallest));
  EXPECT_EQ(values_difference("a = 1\n", "a = 1\nb = 2\n"), "  b = (absent), and there 2\n");
}

TEST(Robot, AnUnknownKindIsTheOnlyMistakeThatIsTold) {
  const std::string sensor = "[[sensor]]\nname = \"s0\"\nkind = \"digital\"\ndevice = \"d0\"\n";
  const std::string defaults = "[defaults.device]\nkind = \"thermo\"\nbus = \"can0\"\nwatchdog_s = 0.1\n";
  const std::string without = replaced("kind = \"moteus\"\n", "") + defaults;
  for (const std::string& text : {replaced("\"moteus\"", "\"thermo\""), replaced("\"loop\"", "\"thermo\""), without}) {
    const Result<RobotConfig> robot = parse_robot(text + sensor, "r.toml");
    ASSERT_FALSE(robot);
    EXPECT_NE(robot.message().find("kind: \"thermo\" is not known"), std::string::npos) << robot.message();
    EXPECT_EQ(robot.message().find('\n'), std::string::npos) << robot.message();
  }
}

TEST(Robot, DuplicatesAreRefused) {
  const std::string device = "[[device]]\nname = \"d0\"\nkind = \"moteus\"\nbus = \"can0\"\nid = 1\n";
  expect_refused(kSmallest + device, "20:8", {"already a [[device]] named \"d0\""});
  expect_refused(kSmallest + device, "23:6", {"1 is already taken on this bus by \"d0\""});
  expect_refused(kSmallest + kSmallest.substr(kSmallest.find("[[joint]]")), "20:8",
                 {"already a [[joint]] named \"j0\""});
  expect_refused(kSmallest + kSmallest.substr(kSmallest.find("[[joint]]")), "21:10",
                 {"\"d0\" already moves another joint (line 10)"});
  expect_refused("name = \"r\"\n" + kSmallest, "2:8", {"not TOML"});
}

TEST(Robot, LimitsTheWrongWayRoundAreRefused) {
  expect_refused(replaced("position_max_rad = 1", "position_max_rad = -2"), "14:20", {"not above position_min_rad"});
  expect_refused(kSmallest + "sign = 0\n", "19:8", {"give 1 or -1"});
}

TEST(Robot, AWatchdogShorterThanAFewTicksIsRefused) {
  expect_refused("rate_hz = 100\n" + replaced("id = 1", "id = 1\nwatchdog_s = 0.02"), "11:14", {"less than 4 ticks"});
}

TEST(Robot, NamesThatCannotNameASocketAreRefused) {
  for (const char* name : {"", "a/b", "..", "-x", "a b", "0123456789012345678901234567890123"})
    expect_refused(replaced("\"r\"", '"' + std::string(name) + '"'), "1:8", {"is no name"});
}

TEST(Robot, MoreJointsThanTheCapacityAreRefused) {
  std::string text = "name = \"r\"\n[[bus]]\nname = \"can0\"\nkind = \"loop\"\n";
  const std::size_t count = kMaxJoints + 1;
  for (std::size_t i = 0; i < count; ++i) {
    const std::string n = std::to_string(i);
    text += "[[device]]\nname = \"d" + n + "\"\nkind = \"moteus\"\nbus = \"can0\"\nid = " + std::to_string(i + 1) +
            "\n[[joint]]\nname = \"j" + n + "\"\ndevice = \"d" + n +
            "\"\nposition_min_rad = -1\nposition_max_rad = 1\nvelocity_max_rad_s = 1\ntorque_max_nm = "
            "1\ntorque_slew_nm_s = 1\nsafe_kd_nm_s_rad = 0.1\n";
  }
  expect_refused(text, std::to_string(4 + 14 * kMaxJoints + 6) + ":1",
                 {"built for " + std::to_string(kMaxJoints), "-DLITHE_NJ=" + std::to_string(count)});
}

TEST(Robot, DefaultsFillWhatJointsLeaveOut) {
  const std::string text = R"(name = "r"
[defaults.device]
kind = "moteus"
bus = "can0"
[defaults.joint]
position_min_rad = -1
position_max_rad = 1
velocity_max_rad_s = 10
torque_max_nm = 1
torque_slew_nm_s = 100
safe_kd_nm_s_rad = 0.1
[defaults.joint.sim]
mgl_nm = 0.5
[[bus]]
name = "can0"
kind = "loop"
[[device]]
name = "a"
id = 1
[[device]]
name = "b"
id = 2
[[joint]]
name = "a"
device = "a"
[[joint]]
name = "b"
device = "b"
torque_max_nm = 2
[joint.sim]
seed = 7
)";
  const Result<RobotConfig> robot = parse_robot(text, "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  EXPECT_EQ(robot->joints[0].torque_max_nm, 1.0);
  EXPECT_EQ(robot->joints[1].torque_max_nm, 2.0);
  EXPECT_EQ(robot->joints[1].sim.mgl_nm, 0.5);
  EXPECT_EQ(robot->joints[1].sim.seed, 7U);
  EXPECT_EQ(robot->joints[1].device, 1U);
  std::string broken = text;
  broken.replace(broken.find("torque_max_nm"), 13, "torque_mxa_nm");
  expect_refused(broken, "9:1", {"[defaults.joint]", "did you mean 'torque_max_nm'?"});
}

TEST(Robot, SeveralMistakesAreAllReportedAtOnce) {
  std::string text = replaced("id = 1", "id = 900");
  text.replace(text.find("torque_max_nm"), 13, "torque");
  expect_refused(text, "9:6", {"900 will not do", "'torque' is no key", "torque_max_nm is missing"});
}

TEST(Robot, FilesThatCannotBeReadSaySo) {
  const Result<RobotConfig> missing = load_robot("/nowhere/arm.toml");
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.message().find("No such file"), std::string::npos);
  const Result<RobotConfig> folder = load_robot(LITHE_ROBOTS);
  ASSERT_FALSE(folder);
  EXPECT_NE(folder.message().find("is a directory"), std::string::npos);
  const Result<RobotConfig> endless = load_robot("/dev/zero");
  ASSERT_FALSE(endless);
  EXPECT_NE(endless.message().find("is a device"), std::string::npos);
}

TEST(Robot, BytesThatAreNoTextAreRefusedAtTheirPlace) {
  expect_refused("name = \"r\"\n[[\xFF\n", "2:3", {"byte 0xFF is no text", "UTF-8"});
}

// TOML can contain characters that must not be sent to a terminal: "\\u001b". Refused in every string, quoted safely.
TEST(Robot, EveryStringIsPrintable) {
  for (const char* escape : {"\\u001b[2J", "\\n", "\\u0000", "\\u007f", "\\u009b", "\\u202e", "\\u2066", "\\u200b"}) {
    const std::string bad = std::string("\"a") + escape + "b\"";
    const std::string text = bad + " = 1\nlaw = " + bad + "\nname = " + bad + "\n[[bus]]\nname = " + bad +
                             "\nkind = \"loop\"\n[[device]]\nname = " + bad + "\nbus = " + bad +
                             "\n[[joint]]\nname = " + bad + "\ngroup = " + bad + "\n";
    const Result<RobotConfig> robot = parse_robot(text, "r.toml");
    ASSERT_FALSE(robot);
    for (const char* line :
         {"r.toml:1:", "r.toml:2:", "r.toml:3:", "r.toml:5:", "r.toml:8:", "r.toml:11:", "r.toml:12:"})
      EXPECT_NE(robot.message().find(line), std::string::npos) << line << "\n" << robot.message();
    EXPECT_EQ(printable(robot.message(), true), robot.message());
  }
}

// Each of these is undefined behaviour in plain toml++ 3.3 (spine/robot/read/toml.hpp).
TEST(Robot, BrokenHeadersAndStrayLettersAreReportedLikeAnyOtherMistake) {
  for (const char* text : {"[[)oint]]\n", "[)oint]\n", "[[{evice]]\n", "name = \"r\" \xC3\xA9\n", "\xC3\xA9 = 1\n"})
    expect_refused(text, "1:", {"not TOML"});
}

TEST(Robot, RandomDamageNeverCrashesAndIsReportedOrHarmless) {
  std::ifstream file(LITHE_ROBOTS "/arm.toml");
  const std::string whole((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  std::mt19937 random(1);
  for (int round = 0; round < 2000; ++round) {
    std::string text = whole;
    for (int hits = static_cast<int>(random() % 6); hits >= 0; --hits)
      text[random() % text.size()] = static_cast<char>(round % 2 == 0 ? random() % 256 : 32 + random() % 95);
    if (round % 4 == 0) text.resize(random() % text.size());
    const Result<RobotConfig> robot = parse_robot(text, "r.toml");
    if (!robot) EXPECT_EQ(robot.message().rfind("r.toml:", 0), 0U) << robot.message();
  }
}

}  // namespace
}  // namespace lithe::robot
