// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/item.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>

#include "host/read/machine.hpp"
#include "host/read/words.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr std::size_t kMostShown = 160;
constexpr std::size_t kNamed = 4;

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

std::string shown(const Reading& reading) {
  if (reading.is_absent()) return "(absent)";
  if (!reading.known()) return fmt::format("({})", std::strerror(reading.error));
  std::string value = reading.value.substr(0, kMostShown);
  std::ranges::replace(value, '\n', ' ');
  std::erase(value, '\0');  // texts of a device tree end with one
  return value + (reading.value.size() > kMostShown ? "..." : "");
}

State worst(std::initializer_list<State> parts) {
  for (const State state : {State::fail, State::warn, State::unknown, State::ok})
    if (contains(parts, state)) return state;
  return State::not_applicable;
}

Reading Notes::read(const std::string& path) {
  Reading reading = files_.read(path);
  evidence_.push_back({path, shown(reading)});
  return reading;
}

std::optional<long long> Notes::number(const std::string& path) { return whole_number(read(path).value); }

Finding Notes::unread(const std::string& path) const {
  const auto at = std::ranges::find_if(evidence_, [&](const Evidence& each) { return each.path == path; });
  return say(State::unknown, fmt::format("{} says nothing that can be judged: {}", path,
                                         at == evidence_.end() || at->value.empty() ? "(empty)" : at->value));
}

Finding Notes::not_whole(const Tasks& tasks) {
  add(kAllTasks, tasks.why_not_whole);
  return say(State::unknown, tasks.why_not_whole);
}

std::string some_of(const std::vector<std::string>& names, const char* noun) {
  std::string text = fmt::format("{} {}{}", names.size(), noun, names.size() == 1 ? "" : "s");
  for (std::size_t i = 0; i < std::min(names.size(), kNamed); ++i) text += (i == 0 ? " (" : ", ") + names[i];
  return text + (names.empty() ? "" : names.size() > kNamed ? ", ...)" : ")");
}

bool has_no(const Subject& subject, const std::string& parent, const std::string& name) {
  return subject.files.is_folder(parent) && subject.files.is_gone(parent + "/" + name);
}

}  // namespace lithe::host
