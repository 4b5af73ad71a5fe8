// SPDX-License-Identifier: Apache-2.0
// cgroup v2 made of files: what the kernel does between two system calls, for the groups below one root.
#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include "host/test/root_rig.hpp"
#include "spine/core/host/shield_group.hpp"

namespace lithe::host {

class FakeGroups {
 public:
  enum class Kernel { isolates, refuses, says_invalid };

  explicit FakeGroups(const FakeRoot& root, Kernel kernel = Kernel::isolates) : root_(root), kernel_(kernel) {
    root.write("/proc/sys/kernel/osrelease", "6.6.1\n");
    root.write(std::string(kGroupsRoot) + "/cgroup.controllers", "cpuset cpu memory\n");
    root.write(std::string(kGroupsRoot) + "/cgroup.procs", "\n");
    root.write(std::string(kGroupsRoot) + "/cgroup.subtree_control", "cpu memory\n");
  }

  // To be called before each system call of the code under test. `lowering`: a group that is empty may go: rmdir(2) of
  // the kernel does not mind the files in it.
  void settle(bool lowering = false) {
    control(std::string(kGroupsRoot) + "/cgroup.subtree_control", "cpu memory");
    const std::string group = root_.path() + kShieldGroup;
    if (!std::filesystem::is_directory(group)) {
      going_ = false;
      return;
    }
    if (!std::filesystem::exists(group + "/cgroup.type")) {
      if (lowering || going_) return;
      for (const char* file : {"cgroup.subtree_control", "cgroup.threads", "cpuset.cpus"}) put(file, "");
      put("cgroup.type", "domain");
      if (kernel_ != Kernel::refuses) put("cpuset.cpus.partition", "member");
      return;
    }
    control(std::string(kShieldGroup) + "/cgroup.subtree_control", "");
    put("cpuset.cpus.effective", get("cpuset.cpus"));
    used_ = used_ || !get("cpuset.cpus").empty();
    const std::string state = get("cpuset.cpus.partition");
    if (state == "isolated" && kernel_ == Kernel::says_invalid)
      put("cpuset.cpus.partition", "isolated invalid (Cpu list in cpuset.cpus not exclusive)");
    if ((used_ || lowering) && get("cpuset.cpus").empty() && (state == "member" || state.empty())) {
      for (const auto& each : std::filesystem::directory_iterator(group)) std::filesystem::remove(each.path());
      going_ = true;
      used_ = false;
    }
  }

 private:
  std::string get(const std::string& name) const { return read(std::string(kShieldGroup) + "/" + name); }
  void put(const std::string& name, const std::string& text) const {
    root_.write(std::string(kShieldGroup) + "/" + name, text + "\n");
  }
  std::string read(const std::string& path) const {
    std::ifstream file(root_.path() + path);
    std::string line;
    std::getline(file, line);
    return line;
  }
  // "+cpuset" adds a word; the kernel shows words, not what was written.
  void control(const std::string& path, const std::string& others) const {
    const std::string now = read(path);
    if (now.starts_with('+')) root_.write(path, now.substr(1) + (others.empty() ? "" : " " + others) + "\n");
    if (now.starts_with('-')) root_.write(path, others + "\n");
  }

  const FakeRoot& root_;
  Kernel kernel_;
  bool used_ = false, going_ = false;
};

}  // namespace lithe::host
