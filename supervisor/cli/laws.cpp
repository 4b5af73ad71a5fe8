// SPDX-License-Identifier: Apache-2.0
// Laws as files: finding, listing, checking, swapping in.
#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <optional>
#include <system_error>

#include "spine/core/host/files.hpp"
#include "spine/core/time.hpp"
#include "supervisor/cli/act.hpp"
#include "supervisor/cli/print.hpp"
#include "supervisor/cli/talk.hpp"
#include "supervisor/core/process.hpp"
#include "supervisor/link/lawd_link.hpp"
#include "supervisor/link/presence.hpp"

namespace lithe::cli {
namespace {

namespace fs = std::filesystem;

// Installed beside the program, else the source tree it was built from.
fs::path laws_dir() {
  const fs::path installed = fs::path(control::program_dir()) / "../share/lithe/laws";
  return fs::is_directory(installed) ? installed : fs::path(LITHE_LAWS_DIR);
}

struct Source {
  std::string name;
  std::string text;
};

// A path, or the bare name of a law that comes with LITHE.
std::variant<Source, Refusal> read_law(const std::string& law) {
  std::error_code failure;
  fs::path path = law;
  if (!fs::exists(path, failure) && law.find('/') == std::string::npos) {
    const fs::path known = laws_dir() / (path.extension() == ".cpp" ? law : law + ".cpp");
    path = fs::exists(known, failure) ? known : path;
  }
  const auto text = read_regular_file(path.string(), kMaxLawBytes);
  if (!text || text->empty()) {
    return Refusal{
        "no_source", text ? path.string() + ":1: the file is empty" : "cannot read the law " + text.message(),
        text ? "a law is a struct with a static step() and ends with LITHE_LAW(Type, \"name\"); start from one that "
               "lithe law list shows"
             : "give the path of one C++ file, or a name that lithe law list shows"};
  }
  return Source{path.filename().string(), *text};
}

// The first comment after the licence line says what the law is for.
std::string about(const fs::path& path) {
  std::ifstream file(path);
  std::string line;
  while (std::getline(file, line)) {
    if (line.rfind("// ", 0) == 0 && line.find("SPDX") == std::string::npos) {
      return line.substr(3);
    }
  }
  return "";
}

constexpr std::size_t kJointsWithoutARobot = 6;  // as an arm: a small number shows a law that indexes beyond its joints

// Without a robot the check starts its own compile service.
Answer check_alone(const Source& source) {
  control::LawdLink lawd(control::program_dir() + "/lawd", {}, kJointsWithoutARobot);
  if (const auto started = lawd.start(monotonic_ns()); !started) {
    return Refusal{"lawd_failed", started.message(), "is the build complete (make)?"};
  }
  std::optional<Answer> answer;
  lawd.compile({source.name, source.text}, [&answer](const Answer& got) { answer = got; }, monotonic_ns());
  while (!answer) {
    pollfd wait{lawd.poll_fd(), POLLIN, 0};
    ::poll(&wait, 1, 50);
    lawd.serve(monotonic_ns());
  }
  if (Json* result = std::get_if<Json>(&*answer)) {
    result->erase("id");
    result->erase("ok");
  }
  return *answer;
}

}  // namespace

int swap_law(const Context& context, const std::string& law, const std::vector<std::string>& params,
             const std::map<std::string, double>& terms) {
  const auto source = read_law(law);
  if (const auto* refusal = std::get_if<Refusal>(&source)) {
    return refuse(context, *refusal);
  }
  Json values = Json::object();
  for (const std::string& word : params) {
    const std::size_t at = word.find('=');
    char* end = nullptr;
    const double value = at == std::string::npos ? NAN : std::strtod(word.c_str() + at + 1, &end);
    if (at == std::string::npos || at == 0 || end == nullptr || *end != '\0' || !std::isfinite(value)) {
      return refuse(context,
                    {"usage", fmt::format("'{}' is not NAME=VALUE", word), "lithe swap LAW.cpp --param kp=2.5"});
    }
    values[word.substr(0, at)] = value;
  }
  const Source& file = std::get<Source>(source);
  Json args = {{"name", file.name}, {"source", file.text}, {"params", values}};
  for (const auto& [name, value] : terms) {
    args[name] = value;
  }
  return finish(context, ask(context, "swap", args, kCompileMs), print_swap);
}

int law_check(const Context& context, const std::string& law) {
  const auto source = read_law(law);
  if (const auto* refusal = std::get_if<Refusal>(&source)) {
    return refuse(context, *refusal);
  }
  const Source& file = std::get<Source>(source);
  auto client = connect(context);
  if (const auto* refusal = std::get_if<Refusal>(&client); refusal != nullptr && !control::is_nobody(*refusal)) {
    return refuse(context, *refusal);
  }
  const Answer answer = std::holds_alternative<Refusal>(client)
                            ? check_alone(file)
                            : std::get<control::Client>(client).call(
                                  "law_check", {{"name", file.name}, {"source", file.text}}, kCompileMs);
  return finish(context, answer, print_check);
}

int law_list(const Context& context) {
  Json files = Json::array();
  std::vector<fs::path> paths;
  std::error_code failure;
  for (const auto& entry : fs::directory_iterator(laws_dir(), failure)) {
    const std::string stem = entry.path().stem().string();
    if (entry.path().extension() == ".cpp" && (stem.size() < 5 || stem.substr(stem.size() - 5) != "_test")) {
      paths.push_back(entry.path());
    }
  }
  std::sort(paths.begin(), paths.end());
  for (const fs::path& path : paths) {
    files.push_back(
        {{"name", path.stem().string()}, {"path", path.lexically_normal().string()}, {"about", about(path)}});
  }
  Json laws = {{"files", files}, {"resident", Json::array()}};
  const Answer resident = ask(context, "law_list", Json::object());
  if (const Json* result = std::get_if<Json>(&resident)) {
    laws["resident"] = (*result)["resident"];
  } else if (!control::is_nobody(std::get<Refusal>(resident))) {
    return refuse(context, std::get<Refusal>(resident));
  }
  return finish(context, laws, print_laws);
}

}  // namespace lithe::cli
