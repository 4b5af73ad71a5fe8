// SPDX-License-Identifier: Apache-2.0
#include "host/tune/lasting.hpp"

#include <algorithm>
#include <cstring>
#include <functional>
#include <utility>

#include "host/read/machine.hpp"
#include "host/read/words.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

// One rule: which value a file should have, given the one it has. The same value: nothing to do.
struct Rule {
  const char* item;
  std::string path;
  const char* why;
  std::function<std::string(const std::string& now)> wanted;
};

class Planner {
 public:
  Planner(const HostFiles& files, const std::vector<int>& cores)
      : files_(files), cores_(cores), others_(cores_without(online_cores(files), cores)) {}

  void look_at(const Rule& rule) {
    const Reading reading = files_.read(rule.path);
    if (reading.is_absent()) return;
    if (!reading.known()) return refuse(rule, std::strerror(reading.error));
    const std::string now = value_in_force(reading.value);
    const std::string wanted = rule.wanted(now);
    if (wanted.empty()) return refuse(rule, "no value was found for it beside \"" + now + "\"");
    if (wanted == now) return;
    plan_.changes.push_back({.item = rule.item, .path = rule.path, .before = now, .after = wanted, .why = rule.why});
  }

  // Without the robot's cores; all others where it would be none. A text that is no list of cores gives "".
  std::string list_off(const std::string& list) const {
    const std::vector<int> now = parse_cpu_list(list);
    if (now.empty() || !share_a_core(now, cores_)) return now.empty() ? "" : list;
    const std::vector<int> rest = cores_without(now, cores_);
    return cpu_list(rest.empty() ? others_ : rest);
  }

  std::string mask_off(const std::string& mask) const {
    const std::vector<int> now = parse_mask(mask).value_or(std::vector<int>());
    if (now.empty() || !share_a_core(now, cores_)) return now.empty() ? "" : mask;
    const std::vector<int> rest = cores_without(now, cores_);
    const std::vector<int>& kept = rest.empty() ? others_ : rest;
    return kept.empty() ? "" : mask_of(kept, mask);
  }

  void refuse(const Rule& rule, std::string why) { plan_.not_done.push_back({rule.item, rule.path, std::move(why)}); }

  void note(std::string text) { plan_.notes.push_back(std::move(text)); }

  const HostFiles& files() const { return files_; }
  const std::vector<int>& cores() const { return cores_; }
  Plan take() { return std::move(plan_); }

 private:
  const HostFiles& files_;
  const std::vector<int>& cores_;
  std::vector<int> others_;
  Plan plan_;
};

void plan_interrupts(Planner& plan) {
  const auto list_off = [&](const std::string& now) { return plan.list_off(now); };
  const auto mask_off = [&](const std::string& now) { return plan.mask_off(now); };
  plan.look_at(
      {"irq_default", "/proc/irq/default_smp_affinity", "new device interrupts keep off the robot's cores", mask_off});
  for (const std::string& number : plan.files().list("/proc/irq")) {
    if (!whole_number<unsigned>(number)) continue;
    plan.look_at({"irq_affinity", "/proc/irq/" + number + "/smp_affinity_list",
                  "a device interrupt on the robot's core delays its tick", list_off});
  }
}

void plan_workqueues(Planner& plan) {
  const char* const why = "unbound work of the kernel runs on the other cores";
  const auto mask_off = [&](const std::string& now) { return plan.mask_off(now); };
  const std::string folder = "/sys/devices/virtual/workqueue";
  plan.look_at({"workqueue", folder + "/cpumask", why, mask_off});
  for (const std::string& queue : plan.files().list(folder))
    plan.look_at({"workqueue", folder + "/" + queue + "/cpumask", why, mask_off});
}

std::function<std::string(const std::string&)> exactly(const char* value) {
  return [value](const std::string&) { return std::string(value); };
}

std::string ten_or_more(const std::string& now) {
  return whole_number<unsigned long long>(now).value_or(0) >= 10 ? now : "10";
}

// What the sysctl file below keeps for later boots, and the two that need the core's number.
void plan_sysctls(Planner& plan) {
  const std::string kernel = "/proc/sys/kernel/";
  plan.look_at({"timer_migration", kernel + "timer_migration", "timers stay where they were set, off the robot's core",
                exactly("0")});
  plan.look_at(
      {"vmstat", "/proc/sys/vm/stat_interval", "the kernel counts its memory on each core less often", ten_or_more});
  plan.look_at(
      {"watchdog", kernel + "nmi_watchdog", "no counter interrupts every core to look for lockups", exactly("0")});
  plan.look_at({"watchdog", kernel + "watchdog_cpumask", "no watchdog thread on the robot's core",
                [&](const std::string& now) { return plan.list_off(now); }});
  plan.look_at({"numa_balancing", kernel + "numa_balancing", "the kernel does not unmap pages to see who uses them",
                exactly("0")});
}

void plan_memory(Planner& plan) {
  plan.look_at({"huge_pages", "/sys/kernel/mm/transparent_hugepage/enabled",
                "the kernel joins pages only where a program asks for it",
                [](const std::string& now) { return now == "always" ? std::string("madvise") : now; }});
  plan.look_at({"ksm", "/sys/kernel/mm/ksm/run", "the kernel does not scan memory for equal pages",
                [](const std::string& now) { return now == "1" ? std::string("0") : now; }});
}

// A policy is of one core or of several that share their clock.
void plan_frequency(Planner& plan) {
  const std::string root = "/sys/devices/system/cpu/cpufreq";
  for (const std::string& policy : plan.files().list(root)) {
    if (!policy.starts_with("policy")) continue;
    const std::string folder = root + "/" + policy;
    std::string cores = plan.files().read(folder + "/related_cpus").value;
    std::ranges::replace(cores, ' ', ',');
    if (!share_a_core(parse_cpu_list(cores), plan.cores())) continue;
    const Rule rule{"governor", folder + "/scaling_governor", "a core that is slow at first makes the first ticks late",
                    exactly("performance")};
    const Reading known = plan.files().read(folder + "/scaling_available_governors");
    if (known.known() && (" " + known.value + " ").find(" performance ") == std::string::npos) {
      plan.refuse(rule, "this kernel has no governor \"performance\", only: " + known.value);
      continue;
    }
    plan.look_at(rule);
  }
}

void note_irqbalance(Planner& plan) {
  for (const std::string& pid : plan.files().list("/proc"))
    if (whole_number<unsigned>(pid) && plan.files().read("/proc/" + pid + "/comm").value == "irqbalance")
      plan.note("irqbalance runs (pid " + pid + ") and moves interrupts back: sudo systemctl disable --now irqbalance");
}

}  // namespace

Plan runtime_plan(const HostFiles& files, const std::vector<int>& cores) {
  Planner plan(files, cores);
  plan_interrupts(plan);
  plan_workqueues(plan);
  plan_sysctls(plan);
  plan_memory(plan);
  plan_frequency(plan);
  note_irqbalance(plan);
  return plan.take();
}

}  // namespace lithe::host
