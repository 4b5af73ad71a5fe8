// SPDX-License-Identifier: Apache-2.0
#include "host/tune/lasting.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "spine/core/host/cores.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostBytes = std::size_t{64} << 10;  // of a file below /etc
constexpr const char* kWritten = "# Written by lithe tune. lithe tune revert removes it.\n";
constexpr const char* kRulesFolder = "/etc/udev/rules.d";
constexpr const char* kByNumber = "ATTRS{idVendor}";
constexpr const char* kNoDevice = "no such device is there now, or it is a virtual one: no rule";

struct Text {
  const char* item;
  std::string folder, name, text;
  const char* why;
};

void plan_text(const HostFiles& files, Plan& plan, const Text& wanted) {
  if (!files.is_folder(wanted.folder)) return;  // this system has no such folder
  const std::string path = wanted.folder + "/" + wanted.name;
  const Reading now = files.read(path);
  if (!now.known() && !now.is_absent()) return plan.not_done.push_back({wanted.item, path, std::strerror(now.error)});
  Change change{ChangeKind::file, wanted.item, path, now.is_absent(), "", kWritten + wanted.text, wanted.why};
  if (now.known()) {
    const Result<std::string> bytes = read_regular_file(files.root() + path, kMostBytes);
    if (!bytes) return plan.not_done.push_back({wanted.item, path, bytes.message()});
    change.before = *bytes;
  }
  if (change.was_absent || change.before != change.after) plan.changes.push_back(std::move(change));
}

// What may stand between the quotes of a rule.
bool is_plain(const std::string& text) {
  return !text.empty() && std::ranges::all_of(text, [](unsigned char each) {
    return std::isalnum(each) != 0 || std::strchr("._:-", each) != nullptr;
  });
}

// The folder of the device in /sys/devices; empty when there is none.
fs::path device_of(const HostFiles& files, const std::string& path) {
  if (files.is_gone(path)) return {};
  std::error_code failed;
  const fs::path folder = fs::canonical(files.root() + path + "/device", failed);
  return failed ? fs::path() : folder;
}

std::string attribute(const fs::path& folder, const char* name) {
  return HostFiles().read((folder / name).string()).value;
}

// `KERNELS=="spi0.0", `; two channels of one device differ in their port.
std::string net_match(const HostFiles& files, const std::string& interface) {
  const std::string folder = "/sys/class/net/" + interface;
  const std::string parent = device_of(files, folder).filename().string(),
                    port = files.read(folder + "/dev_port").value;
  if (!is_plain(parent)) return "";
  return fmt::format("KERNELS==\"{}\", {}", parent,
                     is_plain(port) ? fmt::format("ATTR{{dev_port}}==\"{}\", ", port) : "");
}

// What a rule can say of a serial device. `by_number`: of its USB device, wherever it is plugged in; empty without one.
struct SerialMatch {
  std::string by_number, by_port;
};

SerialMatch matches_of(const fs::path& device) {
  fs::path below;  // the interface: a USB device may have several
  for (fs::path folder = device; folder.has_relative_path(); below = folder, folder = folder.parent_path()) {
    const std::string vendor = attribute(folder, "idVendor"), product = attribute(folder, "idProduct");
    if (!is_plain(vendor) || !is_plain(product)) continue;
    const std::string serial = attribute(folder, "serial");
    const std::string port = (below.empty() ? folder : below).filename().string();
    return {is_plain(serial) ? fmt::format("{}==\"{}\", ATTRS{{idProduct}}==\"{}\", ATTRS{{serial}}==\"{}\", ",
                                           kByNumber, vendor, product, serial)
                             : "",
            is_plain(port) ? fmt::format("KERNELS==\"{}\", ", port) : ""};
  }
  const std::string parent = device.filename().string();
  return {"", is_plain(parent) ? fmt::format("KERNELS==\"{}\", ", parent) : ""};
}

struct Match {
  std::string text, why_not;
};

// By number, if no other device has the same: the ports of one adapter do, and adapters that were never given one.
Match serial_match(const HostFiles& files, const std::string& path) {
  const std::string folder = "/sys/class/tty/";
  std::error_code failed;
  const fs::path node = fs::canonical(files.root() + path, failed);  // /dev/serial/by-id/... is a link
  const fs::path device = failed ? fs::path() : device_of(files, folder + node.filename().string());
  const SerialMatch wanted = matches_of(device);
  if (wanted.by_port.empty()) return {"", kNoDevice};
  std::vector<SerialMatch> all;
  for (const std::string& each : files.list(folder)) all.push_back(matches_of(device_of(files, folder + each)));
  for (const auto way : {&SerialMatch::by_number, &SerialMatch::by_port})
    if (!(wanted.*way).empty() && std::ranges::count(all, wanted.*way, way) == 1) return {wanted.*way, ""};
  return {"", "another device there cannot be told from it, by its number or its port: no rule"};
}

}  // namespace

Plan lasting_plan(const HostFiles& files) {
  Plan plan;
  plan_text(files, plan,
            {"limits", "/etc/security/limits.d", "lithe.conf", "@lithe - memlock unlimited\n@lithe - nice -20\n",
             "members of the group lithe may lock a robot's memory and raise its priority, from the next login on: "
             "groupadd -f lithe; adduser USER lithe"});
  // The dash: a key that the kernel does not have is no error.
  plan_text(files, plan,
            {kSysctlItem, "/etc/sysctl.d", "90-lithe.conf",
             "-kernel.timer_migration = 0\n-kernel.nmi_watchdog = 0\n-kernel.numa_balancing = 0\n"
             "-vm.stat_interval = 10\n",
             "these settings hold after every boot"});
  return plan;
}

Plan unit_plan(const HostFiles& files, const std::string& program, const std::vector<int>& cores, bool partition) {
  Plan plan;
  // Its folder below /etc alone tells little: packages bring it along.
  if (!files.has("/usr/lib/systemd/systemd") && !files.has("/lib/systemd/systemd")) return plan;
  const std::string text = fmt::format(
      "[Unit]\nDescription=Settings of the kernel for a robot\n\n[Service]\nType=oneshot\nRemainAfterExit=yes\n"
      "# 1: not every setting is possible here.\nSuccessExitStatus=1\n"
      "ExecStart=\"{}\" tune apply --no-files --cores {}{}\n\n[Install]\nWantedBy=multi-user.target\n",
      program, cpu_list(cores), partition ? " --partition" : "");
  plan_text(
      files, plan,
      {kUnitItem, kUnitFolder, kUnit, text, "makes the settings of the kernel again at every start, once enabled"});
  return plan;
}

Plan rules_plan(const HostFiles& files, const robot::RobotConfig& robot) {
  Plan plan;
  if (!files.has("/usr/bin/udevadm") && !files.has("/bin/udevadm")) return plan;
  const std::string name = "70-lithe-" + robot.name + ".rules", path = std::string(kRulesFolder) + "/" + name;
  const std::string before = files.read(path).value;
  std::string rules;
  bool absent = false, by_number = false, ambiguous = false;
  for (const robot::BusConfig& bus : robot.buses) {
    const bool serial = robot::is_serial(bus);
    if (!robot::is_real(bus) || (!serial && bus.interface.empty())) continue;
    const std::string device = serial ? bus.path : "/sys/class/net/" + bus.interface;
    const Match found = serial ? serial_match(files, bus.path) : Match{net_match(files, bus.interface), kNoDevice};
    const std::string& match = found.text;
    by_number = by_number || match.starts_with(kByNumber);
    if (match.empty()) {
      plan.not_done.push_back({kRulesItem, device, found.why_not});
      ambiguous = ambiguous || found.why_not != kNoDevice;
      if (found.why_not != kNoDevice) continue;
      absent = absent || serial;  // what is unplugged now keeps its rule
      const std::string link = serial ? "SYMLINK+=\"lithe/" + bus.name + "\"" : "NAME=\"" + bus.interface + "\"";
      for (const std::string_view line : lines_in(before))
        if (has_text(line, link)) rules += std::string(line) + "\n";
    } else if (serial) {
      rules += fmt::format("SUBSYSTEM==\"tty\", {}SYMLINK+=\"lithe/{}\", GROUP=\"dialout\", MODE=\"0660\"\n", match,
                           bus.name);
      if (bus.path != "/dev/lithe/" + bus.name) {
        plan.notes.push_back(
            fmt::format("once the rules are in force: path = \"/dev/lithe/{}\" in {}, instead of \"{}\"", bus.name,
                        robot.path, bus.path));
      }
    } else {
      rules += fmt::format("SUBSYSTEM==\"net\", ACTION==\"add\", {}NAME=\"{}\"\n", match, bus.interface);
    }
  }
  if (absent && by_number)
    plan.notes.push_back(
        "an adapter is known by its number: apply again with all plugged in, should two have the same");
  if (!rules.empty() || (ambiguous && !before.empty())) {
    plan_text(files, plan,
              {kRulesItem, kRulesFolder, name, rules,
               "the devices of the robot's buses keep their names, and its user may open them"});
  }
  return plan;
}

}  // namespace lithe::host
