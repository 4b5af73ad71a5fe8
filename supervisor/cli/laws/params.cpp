// SPDX-License-Identifier: Apache-2.0
// `lithe param`: parameters of the running law, shown, changed, and written into its source file.
#include "supervisor/cli/laws/params.hpp"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <optional>
#include <regex>
#include <system_error>

#include "spine/core/host/files.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/core/print.hpp"
#include "supervisor/cli/core/talk.hpp"

namespace lithe::cli {
namespace {

void print_params(const Json& params) {
  fmt::print("law {}\n{}{}", word(params, "law"), param_rows(params["params"]), warning_lines(params, ""));
}

// Position of a Param's default: its name, a brace, a number. Only the number is changed.
std::optional<std::pair<std::size_t, std::size_t>> find_default(const std::string& text, const std::string& name) {
  const std::regex pattern("\\b" + name + R"(\s*\{\s*([-+]?[0-9.][0-9.eE+\-]*))");
  std::smatch match;
  if (!std::regex_search(text, match, pattern)) return std::nullopt;
  return std::pair(static_cast<std::size_t>(match.position(1)), static_cast<std::size_t>(match.length(1)));
}

bool names_law(const std::string& text, const std::string& law) {
  return std::regex_search(text, std::regex(R"(LITHE_LAW\s*\([^,]*,\s*")" + law + "\"\\s*\\)"));
}

}  // namespace

std::string param_rows(const Json& params) {
  std::string rows;
  for (const Json& each : params) {
    rows += fmt::format("  {:<24} {:12.6g}   [{:g}, {:g}]\n", word(each, "name"), number(each, "value"),
                        number(each, "min"), number(each, "max"));
  }
  return rows;
}

Json param_values(const std::vector<std::string>& words, const char* example) {
  Json values = Json::object();
  for (const std::string& each : words) {
    const std::size_t at = each.find('=');
    const char* const end = each.data() + each.size();
    double value = NAN;
    const auto read = at == std::string::npos ? std::from_chars_result{end, std::errc::invalid_argument}
                                              : std::from_chars(each.data() + at + 1, end, value);
    if (at == 0 || read.ec != std::errc() || read.ptr != end || !std::isfinite(value))
      throw Refusal{"usage", fmt::format("'{}' is not NAME=VALUE with a finite number", each), example};
    values[each.substr(0, at)] = value;
  }
  return values;
}

int param_get(const Context& context, const std::string& name) {
  Json result = ask(context, "params", Json::object());
  if (name.empty()) return finish(context, result, print_params);
  Json chosen = Json::array();
  for (const Json& each : result["params"])
    if (each["name"] == name) chosen.push_back(each);
  if (chosen.empty()) {
    throw Refusal{"unknown_param", fmt::format("the running law has no parameter '{}'", name),
                  "see them all: lithe param get"};
  }
  result["params"] = chosen;
  return finish(context, result, print_params);
}

int param_set(const Context& context, const std::vector<std::string>& words) {
  const bool one = words.size() == 2 && words[0].find('=') == std::string::npos;  // NAME VALUE
  const Json args = {
      {"values", param_values(one ? std::vector{words[0] + "=" + words[1]} : words, "lithe param set kp 2.5")}};
  return finish(context, ask(context, "set_params", args, kCompileMs), print_params);  // behind swaps
}

int param_revert(const Context& context) {
  return finish(context, ask(context, "revert_params", Json::object()), print_params);
}

int param_save(const Context& context, const std::string& path) {
  const Json running = ask(context, "params", Json::object());
  const auto read = read_regular_file(path, kMaxLawBytes);
  std::string text = read ? *read : "";
  const std::string law = running.value("law", "");
  if (text.empty() || !names_law(text, law)) {
    throw Refusal{"no_source",
                  text.empty() ? "cannot read " + (read ? path + ": it is empty" : read.message())
                               : fmt::format("{} is not the running law '{}'", path, law),
                  "give the file that ends in LITHE_LAW(..., \"" + law + "\")"};
  }
  for (const Json& each : running["params"]) {
    const std::string name = each["name"];
    const auto place = find_default(text, name);
    if (!place) {
      throw Refusal{"usage", fmt::format("{} has no default of {} as {}{{number, ...}}", path, name, name),
                    "nothing was written; write it as lithe::Param " + name + "{value, least, most}"};
    }
    text.replace(place->first, place->second, fmt::format("{}", each["value"].get<double>()));
  }
  if (const std::string failure = write_file_whole(path, text); !failure.empty()) {
    throw Refusal{"no_source", fmt::format("cannot write {}: {}", path, failure),
                  "the file is as it was; is it writable, is the disk full?"};
  }
  return finish(context, running, [&path](const Json& result) {
    print_params(result);
    fmt::print("written to {}\n", path);
  });
}

}  // namespace lithe::cli
