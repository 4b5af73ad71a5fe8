// SPDX-License-Identifier: Apache-2.0
#include "host/tune/boot/boot.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>

#include "host/read/files.hpp"
#include "host/read/machine.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/text.hpp"

namespace lithe::host {
namespace {

constexpr std::size_t kMostConfigFileBytes = std::size_t{4} << 20;  // Debian's has 260 kB
constexpr const char* kConfigPrefix = "config-";
constexpr const char* kPacked = "/proc/config.gz";
constexpr const char* kRelease = "/proc/sys/kernel/osrelease";
constexpr const char* kAskModule =
    "; where the kernel has it as a module, `sudo modprobe configs` tells: then plan again";
constexpr int kManagedIrqSince = 5006;

bool has_line(const std::string& text, const std::string& line) {
  return ("\n" + text + "\n").find("\n" + line + "\n") != std::string::npos;
}

// 5006 for "5.6.1-v8+"; 0 if it is no release.
int version_of(std::string_view release) {
  const auto version = kernel_version(release);
  return version ? version->first * 1000 + version->second : 0;
}

std::vector<std::string> releases(const HostFiles& files) {
  const Reading running = files.read(kRelease);
  if (running.known() && !running.value.empty()) return {running.value};
  std::vector<std::string> found;
  for (const std::string& name : files.list("/boot"))
    if (name.starts_with(kConfigPrefix)) found.push_back(name.substr(std::string_view(kConfigPrefix).size()));
  return found.empty() ? files.list("/lib/modules") : found;
}

std::string advice(const std::string& why, const char* next = "") {
  return fmt::format("how the kernel was built is not known ({}): only flags that every kernel knows are planned{}",
                     why, next);
}

// Below /boot; of the running kernel also what it tells itself: Raspberry Pi OS and Jetson Linux have no file in /boot.
Result<std::string> config_of(const HostFiles& files, const std::string& release, bool running) {
  Result<std::string> config =
      read_regular_file(files.root() + "/boot/" + (kConfigPrefix + release), kMostConfigFileBytes);
  if (config || !running) return config;
  Result<std::string> packed = read_packed(files, kPacked, kMostConfigFileBytes);
  return packed ? packed : Result<std::string>(Error{config.message() + "; " + packed.message()});
}

// Beyond isolcpus and irqaffinity, in the order in which they are written. `option`: the kernel knows the flag by it.
struct Extra {
  Flag flag;
  const char* option;
};

std::vector<Extra> extras(const Kernel& kernel, const BootCores& cores) {
  std::vector<Extra> all;
  if (!cores.tickless.empty()) all.push_back({{"nohz_full", cpu_list(cores.tickless), true}, "NO_HZ_FULL"});
  all.push_back({{"rcu_nocbs", cpu_list(cores.isolated), true}, "RCU_NOCB_CPU"});
  all.push_back({{"nosoftlockup", ""}, "SOFTLOCKUP_DETECTOR"});
  all.push_back({{"nmi_watchdog", "0"}, "HARDLOCKUP_DETECTOR"});
  all.push_back({{"skew_tick", "1"}, "TICK_ONESHOT"});
  if (kernel.steady_tsc) all.push_back({{"tsc", "reliable"}, "X86_TSC"});
  return all;
}

}  // namespace

bool Kernel::has(std::string_view option) const {
  return !configs.empty() && std::ranges::all_of(configs, [&](const std::string& config) {
    return has_line(config, fmt::format("CONFIG_{}=y", option));
  });
}

bool Kernel::lacks(std::string_view option) const {
  return std::ranges::any_of(configs, [&](const std::string& config) {
    return has_line(config, fmt::format("# CONFIG_{} is not set", option));
  });
}

Kernel read_kernel(const HostFiles& files) {
  Kernel kernel;
  kernel.steady_tsc = has_cpu_flag(files, "constant_tsc") && has_cpu_flag(files, "nonstop_tsc");
  const std::vector<std::string> installed = releases(files);
  const bool running = files.read(kRelease).known();
  for (const std::string& release : installed) {
    const int version = version_of(release);
    kernel.version = kernel.configs.empty() ? version : std::min(kernel.version, version);
    const Result<std::string> config = config_of(files, release, running);
    if (!config && kernel.not_known.empty()) {
      const bool may_tell = running && !files.has(kPacked);  // Raspberry Pi OS: a module
      kernel.not_known.push_back(advice(printable(config.message()), may_tell ? kAskModule : ""));
    }
    kernel.configs.push_back(config ? *config : "");
  }
  if (installed.empty())
    kernel.not_known.push_back(advice("no /proc/sys/kernel/osrelease, no /boot/config-*, no folder in /lib/modules"));
  if (!kernel.not_known.empty()) kernel.configs.clear();
  return kernel;
}

Result<KernelFlags> flags_for(const Kernel& kernel, const BootCores& cores) {
  if (kernel.lacks("CPU_ISOLATION")) {
    return Error{
        "this kernel is built without CONFIG_CPU_ISOLATION: it ignores isolcpus. Install another kernel, or isolate "
        "cores at run time (`lithe run --shield`)"};
  }
  KernelFlags result{.flags = {}, .notes = kernel.not_known};
  std::string isolated = cpu_list(cores.isolated);
  if (kernel.version >= kManagedIrqSince) {
    isolated = "managed_irq,domain," + isolated;
  } else {
    // An older kernel drops the whole flag when it meets a word it does not know.
    result.notes.push_back(fmt::format("{}: isolcpus is planned without managed_irq, which kernels know since 5.6",
                                       kernel.version == 0 ? "the kernel's version is not known" : "an older kernel"));
  }
  result.flags.push_back({"isolcpus", isolated, true});
  std::vector<std::string> left_out;
  if (kernel.has("NO_HZ_FULL")) {
    for (const Extra& extra : extras(kernel, cores))
      if (kernel.has(extra.option))
        result.flags.push_back(extra.flag);
      else
        left_out.push_back(fmt::format("{} (CONFIG_{})", extra.flag.text(), extra.option));
  } else if (!kernel.configs.empty()) {
    result.notes.push_back(
        "the kernel is built without CONFIG_NO_HZ_FULL: the timer's tick stays on the isolated cores");
  }
  if (!left_out.empty()) {
    result.notes.push_back(
        fmt::format("left out, because this kernel does not know it: {}", fmt::join(left_out, ", ")));
  }
  // Written behind rcu_nocbs, where people expect it; to the kernel the order means nothing.
  const auto behind = std::ranges::find_if(result.flags, [](const Flag& flag) { return !flag.isolates; });
  result.flags.insert(behind, {"irqaffinity", std::to_string(cores.housekeeping), true});
  return result;
}

}  // namespace lithe::host
