// SPDX-License-Identifier: Apache-2.0
// `lithe param save`: writes the present parameter values into the law's source file.
#include <fmt/format.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <regex>
#include <system_error>

#include "spine/core/host/files.hpp"
#include "supervisor/cli/act.hpp"
#include "supervisor/cli/print.hpp"
#include "supervisor/cli/talk.hpp"

namespace lithe::cli {
namespace {

namespace fs = std::filesystem;

// Position of a Param's default: its name, a brace, a number. Only the number is changed.
std::optional<std::pair<std::size_t, std::size_t>> find_default(const std::string& text, const std::string& name) {
  const std::regex pattern("\\b" + name + R"(\s*\{\s*([-+]?[0-9.][0-9.eE+\-]*))");
  std::smatch match;
  if (!std::regex_search(text, match, pattern)) {
    return std::nullopt;
  }
  return std::pair(static_cast<std::size_t>(match.position(1)), static_cast<std::size_t>(match.length(1)));
}

bool names_law(const std::string& text, const std::string& law) {
  return std::regex_search(text, std::regex(R"(LITHE_LAW\s*\([^,]*,\s*")" + law + "\"\\s*\\)"));
}

// Replaces the file atomically: afterwards it is either complete and new, or unchanged.
std::error_code replace_file(const fs::path& path, const std::string& text) {
  const fs::path part = path.string() + ".new";
  std::ofstream file(part, std::ios::binary);
  file << text;
  file.close();
  std::error_code failure;
  if (!file) {
    fs::remove(part, failure);
    return std::make_error_code(std::errc::io_error);
  }
  fs::permissions(part, fs::status(path).permissions(), failure);
  fs::rename(part, path, failure);
  return failure;
}

}  // namespace

int param_save(const Context& context, const std::string& path) {
  const Answer answer = ask(context, "params", Json::object());
  const Json* running = std::get_if<Json>(&answer);
  if (running == nullptr) {
    return refuse(context, std::get<Refusal>(answer));
  }
  const auto read = read_regular_file(path, kMaxLawBytes);
  std::string text = read ? *read : "";
  const std::string law = running->value("law", "");
  if (text.empty() || !names_law(text, law)) {
    return refuse(context, {"no_source",
                            text.empty() ? "cannot read " + (read ? path + ": it is empty" : read.message())
                                         : fmt::format("{} is not the running law '{}'", path, law),
                            "give the file that ends in LITHE_LAW(..., \"" + law + "\")"});
  }
  for (const Json& each : (*running)["params"]) {
    const std::string name = each["name"];
    const auto place = find_default(text, name);
    if (!place) {
      return refuse(context, {"usage", fmt::format("{} has no default of {} as {}{{number, ...}}", path, name, name),
                              "nothing was written; write it as lithe::Param " + name + "{value, least, most}"});
    }
    text.replace(place->first, place->second, fmt::format("{}", each["value"].get<double>()));
  }
  if (const auto failure = replace_file(path, text)) {
    return refuse(context, {"no_source", fmt::format("cannot write {}: {}", path, failure.message()),
                            "the file is as it was; is it writable, is the disk full?"});
  }
  return finish(context, answer, [&path](const Json& result) {
    print_params(result);
    fmt::print("written to {}\n", path);
  });
}

}  // namespace lithe::cli
