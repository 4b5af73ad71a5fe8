// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/notes.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>

#include "host/read/words.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr std::size_t kMostShown = 160;
constexpr std::size_t kNamed = 4;

}  // namespace

std::string shown(const Reading& reading) {
  if (reading.is_absent()) return "(absent)";
  if (!reading.known()) return fmt::format("({})", std::strerror(reading.error));
  std::string value = reading.value.substr(0, kMostShown);
  std::replace(value.begin(), value.end(), '\n', ' ');
  std::erase(value, '\0');  // texts of a device tree end with one
  return value + (reading.value.size() > kMostShown ? "..." : "");
}

State worst(std::initializer_list<State> parts) {
  for (const State state : {State::fail, State::warn, State::unknown, State::ok})
    if (std::find(parts.begin(), parts.end(), state) != parts.end()) return state;
  return State::not_applicable;
}

Reading Notes::read(const std::string& path) {
  Reading reading = files_.read(path);
  evidence_.push_back({path, shown(reading)});
  return reading;
}

void Notes::add(const std::string& path, const std::string& value) { evidence_.push_back({path, value}); }

std::optional<long long> Notes::number(const std::string& path) { return whole_number(read(path).value); }

Finding Notes::unread(const std::string& path) const {
  const auto at =
      std::find_if(evidence_.begin(), evidence_.end(), [&](const Evidence& each) { return each.path == path; });
  return say(State::unknown, fmt::format("{} says nothing that can be judged: {}", path,
                                         at == evidence_.end() || at->value.empty() ? "(empty)" : at->value));
}

std::string some_of(const std::vector<std::string>& names, const char* noun) {
  std::string text = fmt::format("{} {}{}", names.size(), noun, names.size() == 1 ? "" : "s");
  for (std::size_t i = 0; i < std::min(names.size(), kNamed); ++i) text += (i == 0 ? " (" : ", ") + names[i];
  return text + (names.empty() ? "" : names.size() > kNamed ? ", ...)" : ")");
}

bool has_no(const Subject& subject, const std::string& parent, const std::string& name) {
  return subject.files.is_folder(parent) && !subject.files.is_folder(parent + "/" + name);
}

}  // namespace lithe::host
