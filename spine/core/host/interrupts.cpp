// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/interrupts.hpp"

#include <algorithm>
#include <cstddef>
#include <sstream>

#include "spine/core/host/cores.hpp"
#include "spine/core/host/files.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/text.hpp"

namespace lithe {
namespace {

constexpr std::size_t kMostTableBytes = std::size_t{8} << 20;  // a machine of 256 cores writes two
constexpr std::size_t kMostListBytes = std::size_t{64} << 10;
constexpr unsigned kFirstSharedOfGic = 32;  // ARM: an interrupt controller's inputs below are each core's own

// "  GICv2  30 Level     arch_timer": what stands behind the counts of a row.
bool is_each_cores_own(const std::string& about) {
  std::istringstream words(about);
  std::string chip, input;
  words >> chip >> input;
  if (chip.starts_with("GIC")) return whole_number<unsigned>(input).value_or(kFirstSharedOfGic) < kFirstSharedOfGic;
  return chip == "RISC-V" && input == "INTC";
}

std::string last_column(std::string about) {
  about.erase(about.find_last_not_of(' ') + 1);
  const std::size_t gap = about.rfind("  ");  // a name may contain single spaces
  return printable(gap == std::string::npos ? about : about.substr(gap + 2));
}

// The core that gets it now. If that file is empty (some kernels and controllers), the cores that it may go to.
Result<std::vector<int>> cores_of(int number, const std::string& root) {
  const std::string folder = root + "/proc/irq/" + std::to_string(number);
  if (const auto effective = read_regular_file(folder + "/effective_affinity_list", kMostListBytes)) {
    if (std::vector<int> cpus = parse_cpu_list(*effective); !cpus.empty()) return cpus;
  }
  const std::string path = folder + "/smp_affinity_list";
  const Result<std::string> allowed = read_regular_file(path, kMostListBytes);
  if (!allowed) return Error{allowed.message()};
  std::vector<int> cpus = parse_cpu_list(*allowed);
  if (cpus.empty()) return Error{path + ": is no list of cores"};
  return cpus;
}

}  // namespace

// The rows of /proc/interrupts that have a number: the others count what the kernel and the cores do among themselves.
Result<std::vector<Interrupt>> device_interrupts(const std::string& root) {
  const std::string path = root + "/proc/interrupts";
  const Result<std::string> table = read_regular_file(path, kMostTableBytes);
  if (!table) return Error{table.message()};
  std::istringstream lines(*table);
  std::string line, word;
  std::getline(lines, line);
  std::size_t cores = 0;
  for (std::istringstream head(line); head >> word;) cores += word.starts_with("CPU") ? 1 : 0;
  if (cores == 0) return Error{path + ": has no column of a core"};
  std::vector<Interrupt> all;
  while (std::getline(lines, line)) {
    std::istringstream row(line);
    row >> word;
    const auto number = whole_number<unsigned>(std::string_view(word).substr(0, word.size() - 1));
    if (!word.ends_with(':') || !number) continue;
    for (std::size_t core = 0; core < cores; ++core) row >> word;
    std::string about;
    std::getline(row, about);
    if (!is_each_cores_own(about)) all.push_back({static_cast<int>(*number), last_column(about)});
  }
  return all;
}

Result<std::vector<Interrupt>> interrupts_of(int cpu, const std::string& root) {
  const Result<std::vector<Interrupt>> all = device_interrupts(root);
  if (!all) return all;
  std::vector<Interrupt> here;
  for (const Interrupt& each : *all) {
    const Result<std::vector<int>> cpus = cores_of(each.number, root);
    if (!cpus) return Error{cpus.message()};
    if (std::binary_search(cpus->begin(), cpus->end(), cpu)) here.push_back(each);
  }
  return here;
}

std::string interrupt_words(const Result<std::vector<Interrupt>>& found) {
  if (!found) return "unknown whether device interrupts may land there (" + found.message() + ")";
  if (found->empty()) return "no device interrupt may land there";
  const std::size_t count = found->size(), named = std::min(count, kInterruptsNamed);
  std::string words = std::to_string(count) + " device interrupt" + (count == 1 ? "" : "s") + " may land there:";
  for (std::size_t i = 0; i < named; ++i)
    words += (i == 0 ? " " : ", ") + std::to_string((*found)[i].number) + " " + (*found)[i].name;
  return words + (count > named ? " and " + std::to_string(count - named) + " more" : "");
}

}  // namespace lithe
