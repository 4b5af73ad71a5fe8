// SPDX-License-Identifier: Apache-2.0
// Laws as files: finding, listing, checking, swapping in.
#include <fmt/format.h>
#include <poll.h>

#include <array>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <optional>
#include <regex>
#include <string_view>
#include <system_error>

#include "spine/core/host/files.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/time.hpp"
#include "spine/robot/read/report.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/cli/laws/show.hpp"
#include "supervisor/link/client/client.hpp"
#include "supervisor/link/services/services.hpp"

namespace lithe::cli {
namespace {

namespace fs = std::filesystem;

struct Source {
  std::string name;
  std::string text;
};

// The laws that come with LITHE.
std::vector<fs::path> known_laws() {
  std::vector<fs::path> laws;
  for (const fs::path& path : files_in(laws_dir()))
    if (path.extension() == ".cpp" && !path.stem().string().ends_with("_test")) laws.push_back(path);
  return laws;
}

// What was probably meant by the name of a law that is not there.
std::string other_laws(const std::string& law) {
  constexpr std::array<std::string_view, 9> kOfTheGuard{"safe",  "safe_law", "safe_stop", "damp", "damping",
                                                        "brake", "off",      "stop",      "estop"};
  const std::string name = fs::path(law).stem();
  std::vector<std::string> known;
  for (const fs::path& path : known_laws()) known.push_back(path.stem());
  const std::string all = "one of: " + joined(known) + "; or the path of one C++ file";
  if (contains(kOfTheGuard, name)) {
    return fmt::format(
        "'{}' is the guard's, no law: lithe estop (the drives damp), lithe disarm (off) or lithe hold "
        "(the running law holds); a law is {}",
        name, all);
  }
  const std::string_view near = robot::nearest(name, {known.begin(), known.end()});
  return near.empty() ? all : fmt::format("did you mean '{}'? {}", near, all);
}

// A path, or the bare name of a law that comes with LITHE. Throws a Refusal.
Source read_law(const std::string& law) {
  std::error_code failure;
  fs::path path = law;
  if (!fs::exists(path, failure) && law.find('/') == std::string::npos) {
    const fs::path known = laws_dir() / (path.extension() == ".cpp" ? law : law + ".cpp");
    path = fs::exists(known, failure) ? known : path;
  }
  if (const std::string kind = path.extension();
      fs::is_regular_file(path, failure) && kind != ".cpp" && kind != ".cc") {
    throw Refusal{"no_source", fmt::format("{} is not taken for a law: its name does not end in .cpp", path.string()),
                  "give the path of one C++ file, or a name that lithe law list shows"};
  }
  const auto text = read_regular_file(path.string(), kMaxLawBytes);
  if (!text || text->empty()) {
    throw Refusal{"no_source", text ? path.string() + ":1: the file is empty" : "cannot read the law " + text.message(),
                  text ? "a law is a struct with a static step() and ends with LITHE_LAW(Type, \"name\"); start from "
                         "one that lithe law list shows"
                       : other_laws(law)};
  }
  return Source{path.filename().string(), *text};
}

// The first comment after the licence line says what the law is for.
std::string about(const fs::path& path) {
  std::ifstream file(path);
  std::string line;
  while (std::getline(file, line))
    if (line.rfind("// ", 0) == 0 && line.find("SPDX") == std::string::npos) return line.substr(3);
  return "";
}

constexpr std::size_t kJointsWithoutARobot = 6;  // as an arm: a small number shows a law that indexes beyond its joints

// Without a robot the check starts its own compile service.
Answer check_alone(const Source& source) {
  control::LawdLink lawd(program_dir() + "/lawd", {}, kJointsWithoutARobot);
  if (const auto started = lawd.start(monotonic_ns()); !started)
    return Refusal{"lawd_failed", started.message(), "is the build complete (make)?"};
  std::optional<Answer> answer;
  lawd.compile({source.name, source.text}, [&answer](const Answer& got) { answer = got; }, monotonic_ns());
  while (!answer) {
    pollfd wait{lawd.poll_fd(), POLLIN, 0};
    ::poll(&wait, 1, 50);
    lawd.serve(monotonic_ns());
  }
  return *answer;
}

void print_measured(const Json& c) {
  const Json shadow = c.value("shadow", Json::object());
  fmt::print(
      "law {} compared with the running one in {} ticks, and not promoted: its torque differs by at most {} N m (rms "
      "{}), joint by joint\n",
      word(c, "law"), shadow.value("ticks", 0), listed(shadow["most_nm"]), listed(shadow["rms_nm"]));
}

void print_swap(const Json& c) {
  if (word(c, "verdict") == "measured") return print_measured(c);
  fmt::print(
      "law {} committed at tick {}: compiled in {:.0f} ms{}, loaded in {:.1f} ms, {:.0f} ms from request to commit, {} "
      "releases missed\n",
      word(c, "law"), c.value("commit_tick", std::uint64_t{0}), number(c, "compile_ms"),
      c.value("cached", false) ? " (cached)" : "", number(c, "load_ms"), number(c, "requested_to_committed_ms"),
      c.value("missed_releases", std::uint64_t{0}));
  if (c.contains("record_lost")) fmt::print("its certificate is not on disk yet: {}\n", word(c, "record_lost"));
  if (c.contains("state_not_carried")) fmt::print("State not carried: {}\n", listed(c["state_not_carried"]["fields"]));
  fmt::print("{}{}", cleaned_lines(c), warning_lines(c.value("trial", Json::object()), ""));
}

void print_check(const Json& result) {
  const Json law = result.value("law", Json::object());
  fmt::print("law {} is fine: compiled in {:.0f} ms{}, dry run passed\n{}{}", word(law, "name"),
             number(result, "compile_ms"), result.value("cached", false) ? " (cached)" : "", cleaned_lines(result),
             param_rows(law.value("params", Json::array())));
}

// "; confirmed, rms error shoulder 0.012, elbow 0.03 rad"
std::string score_words(const Json& score) {
  if (!score.is_object()) return "";
  std::string errors;
  const Json rms_error_rad = score.value("rms_error_rad", Json::object());
  for (const auto& [joint, rms_rad] : rms_error_rad.items())
    errors += fmt::format("{} {} {:.4g}", errors.empty() ? ", rms error" : ",", joint, rms_rad.get<double>());
  return fmt::format("; {}{}", word(score, "verdict"), errors.empty() ? "" : errors + " rad");
}

void print_laws(const Json& laws) {
  for (const Json& each : laws["files"]) fmt::print("  {:<20} {}\n", word(each, "name"), word(each, "about"));
  for (const Json& each : laws["resident"]) {
    fmt::print("in the Spine: {} ({}){}{}\n", word(each, "law"), each.value("law_id", 0),
               each.value("active", false) ? ", running" : "", score_words(each.value("score", Json())));
  }
}

}  // namespace

fs::path laws_dir() {
  const fs::path installed = fs::path(program_dir()) / "../share/lithe/laws";
  return fs::is_directory(installed) ? installed : fs::path(LITHE_LAWS_DIR);
}

int rollback(const Context& context, int steps) {
  return finish(context, ask(context, "rollback", {{"steps", steps}}),
                [](const Json& result) { print_command("rollback", result); });
}

int law_activate(const Context& context, const std::string& law) {
  return finish(context, ask(context, "activate", {{"law", law}}),
                [](const Json& result) { print_command("activate", result); });
}

int swap_law(const Context& context, const std::string& law, const std::vector<std::string>& params,
             const std::map<std::string, double>& terms, bool no_promote) {
  const Source file = read_law(law);
  Json args = {{"name", file.name},
               {"source", file.text},
               {"params", param_values(params, "lithe swap LAW.cpp --param kp_nm_rad=2.5")}};
  for (const auto& [name, value] : terms) args[name] = value;
  if (no_promote) args["promote"] = false;
  return finish(context, ask(context, "swap", args, kCompileMs), print_swap);
}

int law_check(const Context& context, const std::string& law) {
  const Source file = read_law(law);
  Answer answer = try_ask(context, "law_check", {{"name", file.name}, {"source", file.text}}, kCompileMs);
  const auto* refusal = std::get_if<Refusal>(&answer);
  if (refusal != nullptr && control::is_unreachable(*refusal)) answer = check_alone(file);
  return finish(context, value_of(answer), print_check);
}

int law_list(const Context& context) {
  Json files = Json::array();
  for (const fs::path& path : known_laws()) {
    files.push_back(
        {{"name", path.stem().string()}, {"path", path.lexically_normal().string()}, {"about", about(path)}});
  }
  Json laws = {{"files", files}, {"resident", Json::array()}};
  const Answer resident = try_ask(context, "law_list", Json::object());
  const auto* refusal = std::get_if<Refusal>(&resident);
  if (refusal == nullptr || !control::is_unreachable(*refusal)) laws["resident"] = value_of(resident)["resident"];
  return finish(context, laws, print_laws);
}

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
      {"values", param_values(one ? std::vector{words[0] + "=" + words[1]} : words, "lithe param set kp_nm_rad 2.5")}};
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
