// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/core/print.hpp"

#include <fmt/format.h>

namespace lithe::cli {
namespace {

std::string text(const Json& value) { return value.is_string() ? value.get<std::string>() : value.dump(); }

}  // namespace

double number(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_number() ? found->get<double>() : 0.0;
}

std::string word(const Json& object, const char* key) {
  const auto found = object.find(key);
  return found != object.end() && found->is_string() ? found->get<std::string>() : "-";
}

std::string listed(const Json& words) {
  std::string all;
  for (const Json& each : words) all += (all.empty() ? "" : ", ") + text(each);
  return all;
}

std::string warning_lines(const Json& from, const char* indent) {
  std::string lines;
  const Json warnings = from.value("warnings", Json::array());
  for (const Json& each : warnings) lines += fmt::format("{}warning: {}\n", indent, text(each));
  const Json hints = from.value("hints", Json::array());
  for (const Json& each : hints) lines += fmt::format("{}hint: {}\n", indent, text(each));
  return lines;
}

std::string cleaned_lines(const Json& from) {
  std::string lines;
  const Json notes = from.value("cleaned", Json::array());
  for (const Json& each : notes) lines += fmt::format("cleaned: {}\n", text(each));
  return lines;
}

void print_command(const std::string& verb, const Json& result) {
  fmt::print("{}: mode {} at tick {}{}\n", verb, word(result, "mode"), result.value("tick", std::uint64_t{0}),
             result.contains("law") ? fmt::format(", law {}", word(result, "law")) : "");
}

}  // namespace lithe::cli
