// SPDX-License-Identifier: Apache-2.0
#include "host/tune/lasting.hpp"

#include <gtest/gtest.h>

#include <filesystem>

#include "host/test/machine_rig.hpp"
#include "host/tune/tune.hpp"

namespace lithe::host {
namespace {

namespace fs = std::filesystem;

class LastingTest : public ::testing::Test {
 protected:
  LastingTest() { write_board(root_); }

  HostFiles files() const { return HostFiles(root_.path()); }
  void folder(const std::string& path) const { fs::create_directories(root_.path() + path); }
  void systemd() const {
    folder("/etc/systemd/system");
    root_.write("/usr/lib/systemd/systemd", "");
  }
  void udev() const {
    folder("/etc/udev/rules.d");
    root_.write("/bin/udevadm", "");
  }
  // A device below /sys/devices, and the link of its class to it.
  void device(const std::string& node, const std::string& place) const {
    folder("/sys/devices/" + place);
    folder(node);
    fs::create_symlink(root_.path() + "/sys/devices/" + place, root_.path() + node + "/device");
  }
  static robot::RobotConfig robot(const robot::BusConfig& bus) {
    robot::RobotConfig robot;
    robot.name = "leg";
    robot.path = "leg.toml";
    robot.buses = {bus};
    return robot;
  }
  static robot::BusConfig can(const std::string& interface) {
    robot::BusConfig bus;
    bus.name = "left";
    bus.kind = robot::BusKind::socketcan;
    bus.interface = interface;
    return bus;
  }
  static robot::BusConfig serial(const std::string& path) {
    robot::BusConfig bus;
    bus.name = "left";
    bus.kind = robot::BusKind::fdcanusb;
    bus.path = path;
    return bus;
  }

  FakeRoot root_;
};

TEST_F(LastingTest, FilesAreWrittenOnlyIntoFoldersThatTheSystemHas) {
  EXPECT_EQ(lasting_plan(files()).changes.size(), 2u);
  fs::remove_all(root_.path() + "/etc/security");
  const Plan plan = lasting_plan(files());
  ASSERT_EQ(plan.changes.size(), 1u);
  EXPECT_EQ(plan.changes[0].path, "/etc/sysctl.d/90-lithe.conf");
  EXPECT_TRUE(plan.changes[0].was_absent);
  folder(kUnitFolder);
  EXPECT_TRUE(unit_plan(files(), "/usr/bin/lithe", {1}, false).changes.empty()) << "no systemd";
  folder("/etc/udev/rules.d");
  device("/sys/class/net/can0", "platform/spi0.0");
  EXPECT_TRUE(rules_plan(files(), robot(can("can0"))).changes.empty()) << "no udev";
}

TEST_F(LastingTest, AUnitRepeatsTheSettingsAndNotTheFiles) {
  systemd();
  const Plan plan = unit_plan(files(), "/opt/my tools/lithe", {1, 3}, true);
  ASSERT_EQ(plan.changes.size(), 1u);
  EXPECT_EQ(plan.changes[0].path, "/etc/systemd/system/lithe-tune.service");
  EXPECT_NE(
      plan.changes[0].after.find("ExecStart=\"/opt/my tools/lithe\" tune apply --no-files --cores 1,3 --partition\n"),
      std::string::npos)
      << plan.changes[0].after;
}

TEST_F(LastingTest, ACanInterfaceKeepsItsNameByItsPlace) {
  udev();
  device("/sys/class/net/can0", "platform/spi0.0");
  root_.write("/sys/class/net/can0/dev_port", "0\n");
  const Plan plan = rules_plan(files(), robot(can("can0")));
  ASSERT_EQ(plan.changes.size(), 1u);
  EXPECT_EQ(plan.changes[0].path, "/etc/udev/rules.d/70-lithe-leg.rules");
  EXPECT_NE(plan.changes[0].after.find(
                "\nSUBSYSTEM==\"net\", ACTION==\"add\", KERNELS==\"spi0.0\", ATTR{dev_port}==\"0\", NAME=\"can0\"\n"),
            std::string::npos)
      << plan.changes[0].after;
}

TEST_F(LastingTest, ASerialAdapterGetsANameByItsNumberElseByItsPort) {
  udev();
  root_.write("/dev/ttyACM0", "");
  device("/sys/class/tty/ttyACM0", "usb1/1-1/1-1:1.0");
  root_.write("/sys/devices/usb1/1-1/idVendor", "0483\n");
  root_.write("/sys/devices/usb1/1-1/idProduct", "5740\n");
  const auto rule = [&] { return rules_plan(files(), robot(serial("/dev/ttyACM0"))).changes.at(0).after; };
  EXPECT_NE(
      rule().find(
          "SUBSYSTEM==\"tty\", KERNELS==\"1-1:1.0\", SYMLINK+=\"lithe/left\", GROUP=\"dialout\", MODE=\"0660\"\n"),
      std::string::npos)
      << rule();
  root_.write("/sys/devices/usb1/1-1/serial", "A1\", RUN+=\"x\n");
  EXPECT_EQ(rule().find("RUN"), std::string::npos) << "a device may say anything of itself";
  root_.write("/sys/devices/usb1/1-1/serial", "A1B2\n");
  EXPECT_NE(rule().find("ATTRS{idVendor}==\"0483\", ATTRS{idProduct}==\"5740\", ATTRS{serial}==\"A1B2\", SYMLINK"),
            std::string::npos)
      << rule();
  const Plan plan = rules_plan(files(), robot(serial("/dev/ttyACM0")));
  ASSERT_EQ(plan.notes.size(), 1u);
  EXPECT_NE(plan.notes[0].find("path = \"/dev/lithe/left\" in leg.toml"), std::string::npos) << plan.notes[0];
}

// Two ports of one adapter, or two adapters with the number that their maker gave to all: a link to either would be
// a link to the wrong arm.
TEST_F(LastingTest, DevicesWithTheSameNumberAreToldApartByTheirPortOrGetNoRule) {
  udev();
  const auto adapter = [&](const std::string& tty, const std::string& usb, const std::string& interface) {
    root_.write("/dev/" + tty, "");
    device("/sys/class/tty/" + tty, "usb1/" + usb + "/" + usb + interface + "/" + tty);
    root_.write("/sys/devices/usb1/" + usb + "/idVendor", "0403\n");
    root_.write("/sys/devices/usb1/" + usb + "/idProduct", "6010\n");
    root_.write("/sys/devices/usb1/" + usb + "/serial", "0001\n");
  };
  const std::string kNumber = "ATTRS{idVendor}==\"0403\", ATTRS{idProduct}==\"6010\", ATTRS{serial}==\"0001\", ";
  adapter("ttyUSB0", "1-1", ":1.0");
  robot::RobotConfig both = robot(serial("/dev/ttyUSB0"));
  both.buses.push_back(serial("/dev/ttyUSB1"));
  both.buses.back().name = "right";
  const auto has_rule = [](const std::string& text, const std::string& match, const std::string& name) {
    return text.find("\"tty\", " + match + "SYMLINK+=\"lithe/" + name + "\"") != std::string::npos;
  };
  adapter("ttyUSB1", "1-1", ":1.1");
  Plan plan = rules_plan(files(), both);
  ASSERT_EQ(plan.changes.size(), 1u);
  EXPECT_TRUE(has_rule(plan.changes[0].after, "KERNELS==\"1-1:1.0\", ", "left")) << plan.changes[0].after;
  EXPECT_TRUE(has_rule(plan.changes[0].after, "KERNELS==\"1-1:1.1\", ", "right")) << plan.changes[0].after;

  fs::remove_all(root_.path() + "/sys/class/tty/ttyUSB1");
  adapter("ttyUSB1", "1-2", ":1.0");
  plan = rules_plan(files(), both);
  EXPECT_TRUE(has_rule(plan.changes.at(0).after, "KERNELS==\"1-2:1.0\", ", "right")) << plan.changes[0].after;

  const std::string rules = plan.changes[0].path;
  root_.write(rules, plan.changes[0].after);
  fs::remove_all(root_.path() + "/sys/class/tty/ttyUSB1");
  fs::remove(root_.path() + "/dev/ttyUSB1");
  plan = rules_plan(files(), both);
  ASSERT_EQ(plan.changes.size(), 1u) << "its twin is gone: the other is known by its number";
  EXPECT_TRUE(has_rule(plan.changes[0].after, "KERNELS==\"1-2:1.0\", ", "right")) << "what is unplugged keeps its rule";
  EXPECT_TRUE(has_rule(plan.changes[0].after, kNumber, "left")) << plan.changes[0].after;
  EXPECT_EQ(plan.not_done.size(), 1u);
  EXPECT_NE(plan.notes.back().find("apply again with all plugged in"), std::string::npos) << plan.notes.back();
  root_.write(rules, plan.changes[0].after);
  EXPECT_TRUE(rules_plan(files(), both).changes.empty());

  adapter("ttyUSB1", "1-1", ":1.0");  // two ports of one interface
  plan = rules_plan(files(), both);
  ASSERT_EQ(plan.changes.size(), 1u);
  EXPECT_EQ(plan.changes[0].after.find("SYMLINK"), std::string::npos) << "a rule that may be of the wrong one goes";
  ASSERT_EQ(plan.not_done.size(), 2u);
  EXPECT_NE(plan.not_done[0].why.find("cannot be told from it"), std::string::npos) << plan.not_done[0].why;
}

TEST_F(LastingTest, ADeviceThatIsNotThereIsNamed) {
  udev();
  folder("/sys/class/net/vcan0");
  for (const robot::BusConfig& bus : {can("vcan0"), can("can7"), serial("/dev/ttyACM3")}) {
    const Plan plan = rules_plan(files(), robot(bus));
    EXPECT_TRUE(plan.changes.empty());
    ASSERT_EQ(plan.not_done.size(), 1u);
  }
}

TEST_F(LastingTest, UnitAndRulesAreRevertedToTheByte) {
  systemd();
  udev();
  root_.write("/etc/udev/rules.d/70-lithe-leg.rules", std::string("by hand \xff\n", 10));
  root_.write("/sys/kernel/mm/transparent_hugepage/enabled", "madvise\n");
  device("/sys/class/net/can0", "platform/spi0.0");
  const auto before = content_of(root_);
  Target target{.root = root_.path(), .all_cores = {0, 1, 2, 3}, .cores = {1}, .program = "/usr/bin/lithe"};
  target.robot = robot(can("can0"));
  const TunePlan plan = tune_plan(target);
  EXPECT_EQ(plan.commands, (std::vector<std::string>{"systemctl enable lithe-tune.service",
                                                     "udevadm control --reload && udevadm trigger"}));
  const auto made = tune_apply(target, plan.changes);
  ASSERT_TRUE(made && made->well());
  EXPECT_TRUE(fs::exists(root_.path() + "/etc/systemd/system/lithe-tune.service"));
  EXPECT_TRUE(tune_plan(target).changes.empty());
  EXPECT_EQ(tune_plan(target).commands, (std::vector<std::string>{plan.commands[0]})) << "told until it is enabled";
  const std::string wants = "/etc/systemd/system/multi-user.target.wants/lithe-tune.service";
  root_.write(wants, "");  // as `systemctl enable` does it
  EXPECT_TRUE(tune_plan(target).commands.empty());
  fs::remove_all(fs::path(root_.path() + wants).parent_path());
  target.files = false;
  EXPECT_TRUE(tune_plan(target).changes.empty());
  const auto undone = tune_revert(target, false);
  ASSERT_TRUE(undone && undone->well());
  EXPECT_EQ(undone->commands.size(), 2u);
  EXPECT_EQ(content_of(root_), before);
}

}  // namespace
}  // namespace lithe::host
