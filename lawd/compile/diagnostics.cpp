// SPDX-License-Identifier: Apache-2.0
#include "lawd/compile/diagnostics.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>
#include <vector>

#include "lawd/core/admission.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::lawd {
namespace {

using nlohmann::json;
constexpr std::size_t kMaxEntries = 6;  // the first ones: most of the others follow from them

// The first line that holds `what`, from 1; 0 = none.
int line_with(const std::vector<std::string_view>& lines, std::string_view what) {
  for (std::size_t i = 0; i < lines.size(); ++i)
    if (lines[i].find(what) != std::string::npos) return static_cast<int>(i) + 1;
  return 0;
}

// The line of the law that a message of the contract is about.
int line_about(const std::string& message, const std::vector<std::string_view>& lines) {
  constexpr std::array<std::pair<std::string_view, std::string_view>, 10> kAbout = {{
      {"State field", "struct State"},
      {"State has", "struct State"},
      {"Params has", "struct Params"},
      {"Probes has", "struct Probes"},
      {"State is", "struct State"},
      {"field is longer", "struct"},
      {"of Params", "struct Params"},
      {"Param is", "struct Params"},
      {"of Probes", "struct Probes"},
      {"exactly one step()", " step("},
  }};
  for (const auto& [part, where] : kAbout) {
    if (message.find(part) == std::string::npos) continue;
    if (const int line = line_with(lines, where)) return line;
  }
  return line_with(lines, "LITHE_LAW(");
}

// Explains a compiler message about the end of the file. Empty = the message is clear.
std::string about_the_macro(const std::string& message, const std::string& line) {
  constexpr const char* kHow = "LITHE_LAW takes the law's struct, then its name: LITHE_LAW(Law, \"name\");";
  const auto at = line.find_first_not_of(" \t");
  if (at == std::string::npos || !std::string_view(line).substr(at).starts_with("LITHE_LAW")) return "";
  const bool no_struct = has_text(message, "no matching function for call to") && has_text(message, "describe<");
  const bool swapped = has_text(message, "a law's name has") && has_text(line, "(\"");
  const bool unknown = has_text(message, "was not declared in this scope");
  if (unknown) return message + ": " + kHow;
  return no_struct || swapped || has_text(message, "macro \"LITHE_LAW\"") ? kHow : "";
}

// A compiler message quotes the file it is about. The client sent the law, and may read the contract and the system's
// headers; any other file was read with lawd's permissions and must not be quoted.
bool may_be_quoted(const std::string& file, const Sources& sources) {
  const auto below = [&file](const std::string& folder) { return file.starts_with(folder + "/"); };
  const bool plain = file.find("/../") == std::string::npos;
  return file.empty() || file == sources.path ||
         (plain && (below(sources.contract_dir) || below("/usr/include") || below("/usr/lib/gcc")));
}

json entry(const json& raw, const Sources& sources, const std::vector<std::string_view>& lines) {
  const std::string& name = sources.name;
  json out = {{"file", name}, {"line", 0}, {"column", 0}};
  out["severity"] = raw.value("kind", "error");
  const json places = raw.value("locations", json::array());
  const json caret = places.empty() ? json::object() : places[0].value("caret", json::object());
  const std::string file = caret.value("file", "");
  std::string message = raw.value("message", "");
  if (!may_be_quoted(file, sources))
    message = "does not compile; what stands there is not shown: a law may not include it";
  if (const auto at = message.find("LITHE: "); at != std::string::npos) {
    out["message"] = message.substr(at + 7);
    out["contract"] = true;
    out["line"] = line_about(message, lines);
  } else {
    out["message"] = sources.with_help ? sources.with_help(message) : message;
    if (!file.empty()) {
      if (file != sources.path) out["file"] = file;
      out["line"] = caret.value("line", 0);
      out["column"] = caret.value("column", 0);
    }
  }
  const int line = out["line"];
  const bool own = out["file"] == name && line >= 1 && line <= static_cast<int>(lines.size());
  out["text"] = own ? lines[static_cast<std::size_t>(line) - 1] : std::string_view();
  if (const std::string says = about_the_macro(out["message"], out["text"]); !says.empty()) out["message"] = says;
  return out;
}

// What the compiler printed: its messages, and the lines that are none.
struct Printed {
  std::vector<json> messages;
  std::string rest;
};

// g++ 12 prints its array of messages on one line, g++ 14 spreads it over many. An array without an end (the compiler
// was killed) is left out: it may quote a file that the law may not read.
Printed printed(const std::string& output) {
  Printed result;
  std::string array;
  for (const std::string_view line : lines_in(output)) {
    if (array.empty() && !line.starts_with("[")) {
      if (!line.empty()) result.rest += std::string(line) + "\n";
      continue;
    }
    array += std::string(line) + "\n";
    if (!line.ends_with("]")) continue;
    const json parsed = json::parse(array, nullptr, false);
    if (!parsed.is_array()) continue;
    array.clear();
    for (const json& raw : parsed)
      if (raw.is_object()) result.messages.push_back(raw);
  }
  return result;
}

}  // namespace

Diagnostics read_diagnostics(const std::string& output, const Sources& sources) {
  const std::string& name = sources.name;
  const std::vector<std::string_view> lines = lines_in(sources.text);
  const Printed seen = printed(output);
  std::vector<json> all;
  bool contract = false;
  for (const json& raw : seen.messages) {
    all.push_back(entry(raw, sources, lines));
    contract = contract || all.back().contains("contract");
  }
  Diagnostics result;
  std::size_t more = 0;
  result.list = json::array();
  for (const bool warnings : {false, true}) {  // errors first
    for (json d : all) {
      const bool is_warning = d["severity"] == "warning";
      const bool consequence = contract && !d.contains("contract") && !is_warning &&
                               (d["file"] != name || d["text"].get<std::string>().starts_with("LITHE_LAW"));
      d.erase("contract");
      if (has_text(d["message"].get<std::string>(), "<expression error>"))
        continue;  // follows from an error that is reported itself
      const bool known = std::find(result.list.begin(), result.list.end(), d) != result.list.end();
      if (is_warning != warnings || consequence || known || d["severity"] == "note") continue;
      if (result.list.size() >= kMaxEntries) {
        ++more;
        continue;
      }
      result.text += diagnostic_text(d);
      result.list.push_back(std::move(d));
    }
  }
  if (more > 0) result.text += fmt::format("... and {} more\n", more);
  if (result.list.empty()) result.text = seen.rest;
  return result;
}

}  // namespace lithe::lawd
