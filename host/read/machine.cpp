// SPDX-License-Identifier: Apache-2.0
#include "host/read/machine.hpp"

#include <algorithm>

#include "host/read/words.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/host/interrupts.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr const char* kCpuInfo = "/proc/cpuinfo";
constexpr const char* kModel = "/proc/device-tree/model";
constexpr const char* kStat = "/proc/stat";
constexpr std::size_t kMostCpuInfoBytes = std::size_t{4} << 20;
constexpr std::size_t kMostStatBytes = std::size_t{1} << 20;
constexpr std::size_t kStolen = 8;  // word of a line "cpu1 user nice system idle iowait irq softirq steal ..."

// What stands in a device tree of a virtual machine: QEMU's board `virt`, and a node for the hypervisor.
std::string virtual_words(const HostFiles& files) {
  if (const Reading node = files.read("/proc/device-tree/hypervisor/compatible"); node.known()) return node.value;
  const Reading model = files.read(kModel);
  return has_text(model.value, "dummy-virt") ? model.value : "";
}

}  // namespace

BoardKind board_of(const HostFiles& files) {
  if (!field_of(files.read(kCpuInfo, kMostCpuInfoBytes).value, "vendor_id").empty()) return BoardKind::x86;
  const Reading model = files.read(kModel);
  if (!model.known()) return BoardKind::unknown;
  if (has_text(model.value, "Raspberry Pi")) return BoardKind::raspberry_pi;
  return has_text(model.value, "Jetson") || has_text(model.value, "NVIDIA") ? BoardKind::jetson : BoardKind::other;
}

Hypervisor hypervisor_of(const HostFiles& files) {
  Hypervisor found;
  const Reading cpus = files.read(kCpuInfo, kMostCpuInfoBytes), type = files.read("/sys/hypervisor/type");
  const Reading stat = files.read(kStat, kMostStatBytes);
  if (has_cpu_flag(files, "hypervisor")) found.evidence.emplace_back(kCpuInfo, "flag hypervisor");
  if (!type.value.empty()) found.evidence.emplace_back(type.path, type.value);
  if (const std::string words = virtual_words(files); !words.empty()) found.evidence.emplace_back(kModel, words);
  const std::vector<std::string> all = split(stat.value.substr(0, stat.value.find('\n')));
  const std::optional<long long> stolen = all.size() > kStolen ? whole_number(all[kStolen]) : std::nullopt;
  if (stolen.value_or(0) > 0) found.evidence.emplace_back(kStat, "stolen " + all[kStolen]);
  if (!found.evidence.empty())
    found.present = true;
  else if (stolen && (!field_of(cpus.value, "flags").empty() || board_of(files) != BoardKind::unknown))
    found.present = false;
  return found;
}

std::vector<int> online_cores(const HostFiles& files) {
  return parse_cpu_list(files.read("/sys/devices/system/cpu/online").value);
}

bool has_cpu_flag(const HostFiles& files, const std::string& flag) {
  return has_word(field_of(files.read(kCpuInfo, kMostCpuInfoBytes).value, "flags"), flag);
}

std::string KernelFacts::words() const {
  const std::string name = release.empty() ? "of unknown release" : release;
  if (!is_realtime) return name + ", PREEMPT_RT or not is unknown";
  return *is_realtime ? name + ", PREEMPT_RT" : name;
}

KernelFacts kernel_facts(const HostFiles& files) {
  const Reading version = files.read("/proc/sys/kernel/version");  // "#1 SMP PREEMPT_RT Debian 6.1.76-1 (2024-02-01)"
  KernelFacts facts{files.read("/proc/sys/kernel/osrelease").value, std::nullopt};
  if (version.known()) facts.is_realtime = has_word(version.value, "PREEMPT_RT");
  return facts;
}

std::optional<long long> stolen_ticks(const HostFiles& files, int cpu) {
  const Reading stat = files.read(kStat, kMostStatBytes);
  for (const std::string_view line : lines_in(stat.value)) {
    const std::vector<std::string> words = split(line);
    if (words.size() > kStolen && words[0] == "cpu" + std::to_string(cpu)) return whole_number(words[kStolen]);
  }
  return std::nullopt;
}

std::optional<std::pair<int, int>> kernel_version(const HostFiles& files) {
  return kernel_version(files.read("/proc/sys/kernel/osrelease").value);
}

std::optional<std::pair<int, int>> kernel_version(std::string_view release) {
  const std::size_t dot = release.find('.');
  if (dot == std::string_view::npos) return std::nullopt;
  const auto major = whole_number<int>(release.substr(0, dot));
  const std::string_view rest = release.substr(dot + 1);
  const auto minor = whole_number<int>(rest.substr(0, rest.find_first_not_of("0123456789")));
  return major && minor ? std::optional(std::pair{*major, *minor}) : std::nullopt;
}

namespace {

constexpr std::size_t kMostTableBytes = std::size_t{8} << 20;
constexpr const char* kTable = "/proc/interrupts";

bool is_timer(const std::string& label, const std::vector<std::string>& words) {
  return label == "LOC" || words.back() == "arch_timer" || words.back() == "riscv-timer";
}

bool is_of_cores(const std::string& label) {
  return label == "RES" || label == "CAL" || label == "TLB" || label.starts_with("IPI");
}

void add(std::optional<std::uint64_t>& sum, std::uint64_t count) { sum = sum.value_or(0) + count; }

}  // namespace

std::uint64_t CoreInterrupts::device_total() const {
  std::uint64_t total = 0;
  for (const DeviceCount& each : devices) total += each.count;
  return total;
}

Result<CoreInterrupts> count_interrupts(const HostFiles& files, int cpu) {
  const Result<std::vector<Interrupt>> devices = device_interrupts(files.root());
  const Reading table = files.read(kTable, kMostTableBytes);
  if (!devices || !table.known()) return Error{std::string(kTable) + " cannot be read"};
  const std::vector<std::string> head = split(table.value.substr(0, table.value.find('\n')));
  const auto column = std::ranges::find(head, "CPU" + std::to_string(cpu));
  if (column == head.end()) return Error{std::string(kTable) + " has no column of core " + std::to_string(cpu)};
  const auto at = static_cast<std::size_t>(column - head.begin()) + 1;  // behind the label
  CoreInterrupts counts;
  for (const std::string_view line : lines_in(table.value)) {
    const std::vector<std::string> words = split(line);
    if (words.size() <= at || !words[0].ends_with(':')) continue;
    const std::optional<long long> count = whole_number(words[at]);
    if (!count) continue;
    const std::string label = words[0].substr(0, words[0].size() - 1);
    const auto device =
        std::ranges::find_if(*devices, [&](const Interrupt& each) { return label == std::to_string(each.number); });
    const auto value = static_cast<std::uint64_t>(*count);
    if (device != devices->end())
      counts.devices.push_back({device->number, device->name, value});
    else if (is_timer(label, words))
      add(counts.timer, value);
    else if (is_of_cores(label))
      add(counts.cores, value);
  }
  return counts;
}

namespace {

constexpr int kDeepest = 6;

void walk(const HostFiles& files, const std::string& folder, int depth, std::vector<Partition>& found) {
  Partition each{files.read(folder + "/cpuset.cpus.partition"), files.read(folder + "/cpuset.cpus"), {}};
  // The root group, and groups without a cpuset, have neither file.
  const bool has_cpuset = !each.kind.is_absent() || !each.wanted.is_absent();
  if (has_cpuset && !(each.kind.known() && each.kind.value == "member")) {
    each.cpus = parse_cpu_list(files.read(folder + "/cpuset.cpus.effective").value);
    found.push_back(std::move(each));
  }
  if (depth == 0) return;
  for (const std::string& name : files.list(folder)) {
    const std::string inner = folder + "/" + name;
    if (files.is_folder(inner)) walk(files, inner, depth - 1, found);
  }
}

}  // namespace

std::string cgroup2_folder(const HostFiles& files) {
  for (const char* folder : {"/sys/fs/cgroup", "/sys/fs/cgroup/unified"})
    if (files.has(std::string(folder) + "/cgroup.controllers")) return folder;
  return "";
}

std::vector<Partition> read_partitions(const HostFiles& files) {
  std::vector<Partition> found;
  if (const std::string folder = cgroup2_folder(files); !folder.empty()) walk(files, folder, kDeepest, found);
  return found;
}

}  // namespace lithe::host
