// SPDX-License-Identifier: Apache-2.0
// A fake root with what the kernel of a board shows, and its whole content as data.
#pragma once

#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <random>
#include <string>

#include "host/test/root_rig.hpp"

namespace lithe::host {

inline constexpr const char* kFakeBoot = "11111111-2222-3333-4444-555555555555";

// A board of four cores as it comes: nothing is tuned.
inline void write_board(const FakeRoot& root) {
  root.write("/proc/sys/kernel/random/boot_id", std::string(kFakeBoot) + "\n");
  root.write("/sys/devices/system/cpu/online", "0-3\n");
  root.write("/sys/devices/system/cpu/isolated", "\n");
  root.write("/proc/irq/default_smp_affinity", "f\n");
  root.write("/proc/irq/24/smp_affinity_list", "0-3\n");
  root.write("/proc/irq/25/smp_affinity_list", "1\n");
  root.write("/proc/irq/26/smp_affinity_list", "0,2\n");
  root.write("/sys/devices/virtual/workqueue/cpumask", "f\n");
  root.write("/sys/devices/virtual/workqueue/writeback/cpumask", "f\n");
  root.write("/proc/sys/kernel/timer_migration", "1\n");
  root.write("/proc/sys/kernel/nmi_watchdog", "0\n");
  root.write("/proc/sys/kernel/watchdog_cpumask", "0-3\n");
  root.write("/proc/sys/kernel/numa_balancing", "0\n");
  root.write("/proc/sys/vm/stat_interval", "1\n");
  root.write("/sys/kernel/mm/transparent_hugepage/enabled", "[always] madvise never\n");
  root.write("/sys/kernel/mm/ksm/run", "1\n");
  root.write("/sys/devices/system/cpu/cpufreq/policy0/related_cpus", "0 1 2 3\n");
  root.write("/sys/devices/system/cpu/cpufreq/policy0/scaling_governor", "ondemand\n");
  root.write("/sys/devices/system/cpu/cpufreq/policy0/scaling_available_governors", "ondemand performance \n");
  root.write("/etc/sysctl.d/10-other.conf", "vm.swappiness = 10\n");
  root.write("/etc/security/limits.d/other.conf", "\n");
  root.write("/var/lib/dpkg/status", "\n");
}

// One of many machines: another number of cores, other values, files that this kernel does not have.
inline void write_some_board(const FakeRoot& root, std::mt19937& random) {
  const auto up_to = [&](int most) { return std::uniform_int_distribution<int>(0, most)(random); };
  const int last = 1 + up_to(6);
  write_board(root);
  root.write("/sys/devices/system/cpu/online", "0-" + std::to_string(last) + "\n");
  for (int i = 0; i < 8; ++i) {
    const int from = up_to(last);
    const int to = from + up_to(last - from);
    root.write("/proc/irq/" + std::to_string(30 + i) + "/smp_affinity_list",
               (from == to ? std::to_string(from) : std::to_string(from) + "-" + std::to_string(to)) + "\n");
  }
  root.write("/proc/sys/vm/stat_interval", std::to_string(up_to(20)) + "\n");
  root.write("/proc/sys/kernel/nmi_watchdog", std::to_string(up_to(1)) + "\n");
  const char* const pages[] = {"[always] madvise never\n", "always [madvise] never\n", "always madvise [never]\n"};
  root.write("/sys/kernel/mm/transparent_hugepage/enabled", pages[up_to(2)]);
  if (up_to(1) == 0) root.write("/etc/sysctl.d/90-lithe.conf", std::string("by hand \xff\xfe\x01\n\n", 14));
  const char* const optional[] = {"/proc/irq/default_smp_affinity", "/sys/devices/virtual/workqueue/cpumask",
                                  "/proc/sys/kernel/timer_migration", "/sys/kernel/mm/ksm/run",
                                  "/etc/security/limits.d/other.conf"};
  for (const char* path : optional)
    if (up_to(3) == 0) std::filesystem::remove(root.path() + path);
}

// Every file and folder below a root but the run-time journals: bytes and mode.
inline std::map<std::string, std::string> content_of(const FakeRoot& root) {
  std::map<std::string, std::string> content;
  for (const auto& each : std::filesystem::recursive_directory_iterator(root.path())) {
    const std::string path = each.path().string().substr(root.path().size());
    if (path == "/run" || path.starts_with("/run/")) continue;
    struct stat about{};
    ::lstat(each.path().c_str(), &about);
    std::string bytes;
    if (each.is_regular_file()) {
      std::ifstream file(each.path(), std::ios::binary);
      bytes.assign(std::istreambuf_iterator<char>(file), {});
    }
    content[path] = std::to_string(about.st_mode) + "\n" + bytes;
  }
  return content;
}

}  // namespace lithe::host
