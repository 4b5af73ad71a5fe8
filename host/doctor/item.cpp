// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/item.hpp"

#include <array>

#include "host/doctor/checks/checks.hpp"
#include "host/read/machine.hpp"
#include "host/read/words.hpp"

namespace lithe::host {
namespace {

void replace_all(std::string& text, const std::string& name, const std::string& value) {
  for (std::size_t at = text.find(name); at != std::string::npos; at = text.find(name, at + value.size()))
    text.replace(at, name.size(), value);
}

}  // namespace

const char* word(State state) {
  constexpr std::array kWords = {"ok", "not_applicable", "unknown", "warn", "fail"};
  return kWords.at(static_cast<std::size_t>(state));
}

std::span<const Item> checklist() {
  static const std::vector<Item> all = [] {
    std::vector<Item> joined;
    for (const auto part :
         {scheduler_items(), realtime_items(), interrupts_items(), kernel_noise_items(), power_items(), memory_items()})
      joined.insert(joined.end(), part.begin(), part.end());
    return joined;
  }();
  return all;
}

std::string for_core(const char* text, const Subject& subject) {
  std::vector<int> others = subject.online;
  std::erase(others, subject.cpu);
  std::string words = text;
  replace_all(words, "{cpu}", std::to_string(subject.cpu));
  replace_all(words, "{others}", others.empty() ? "OTHERS" : cpu_list(others));
  replace_all(words, "{others_mask}", others.empty() ? "MASK" : mask_of(others));
  return words;
}

Subject read_subject(const HostFiles& files, int cpu, std::optional<Measured> measured) {
  Subject subject;
  subject.files = files;
  subject.cpu = cpu;
  subject.online = online_cores(files);
  subject.isolated = isolated_cores(0, files.root());
  subject.tasks = read_tasks(files);
  subject.measured = std::move(measured);
  return subject;
}

}  // namespace lithe::host
