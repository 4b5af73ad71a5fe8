// SPDX-License-Identifier: Apache-2.0
#include "lawd/core/admission.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "spine/core/lookup.hpp"

namespace lithe::lawd {

using nlohmann::json;

double since_ms(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

std::string line_of(std::string_view source, int wanted) {
  const auto lines = lines_in(source);
  const auto at = static_cast<std::size_t>(wanted) - 1;
  return wanted >= 1 && at < lines.size() ? std::string(lines[at].substr(0, 200)) : "";
}

void Admission::refuse(std::string_view gate, std::string message, int line, int column) {
  const auto same = [&](const Finding& finding) { return finding.message == message && finding.line == line; };
  if (findings.size() >= kMaxFindings || std::ranges::any_of(findings, same)) return;
  findings.push_back({std::string(gate), std::move(message), line, column});
}

void Admission::apply(const char* gate, const std::function<std::string()>& rule) {
  const auto start = std::chrono::steady_clock::now();
  const std::size_t before = findings.size();
  const std::string not_applied_before = not_applied;
  std::string detail = rule();
  const bool ok = findings.size() == before && not_applied == not_applied_before;
  gates.push_back({gate, ok, since_ms(start), std::move(detail)});
}

json Admission::gates_json() const {
  json list = json::array();
  for (const Gate& gate : gates)
    list.push_back({{"gate", gate.name}, {"ok", gate.ok}, {"ms", gate.ms}, {"detail", gate.detail}});
  return list;
}

json findings_json(const Admission& admission, const std::string& name, std::string_view source) {
  json list = json::array();
  for (const Finding& finding : admission.findings) {
    list.push_back({{"file", name},
                    {"line", finding.line},
                    {"column", finding.column},
                    {"severity", "error"},
                    {"message", finding.message},
                    {"text", finding.line > 0 ? line_of(source, finding.line) : ""},
                    {"gate", finding.gate}});
  }
  return list;
}

std::string diagnostic_text(const json& diagnostic) {
  const int line = diagnostic["line"], column = diagnostic["column"];
  std::string out = diagnostic["file"].get<std::string>();
  if (line > 0) out += fmt::format(":{}", line);
  if (column > 0) out += fmt::format(":{}", column);
  out += fmt::format(": {}: {}", diagnostic["severity"].get<std::string>(), diagnostic["message"].get<std::string>());
  out += diagnostic.contains("gate") ? fmt::format(" [{}]\n", diagnostic["gate"].get<std::string>()) : "\n";
  const std::string text = diagnostic["text"];
  if (text.empty()) return out;
  out += "  " + text + "\n";
  if (column > 0) out += "  " + std::string(static_cast<std::size_t>(column) - 1, ' ') + "^\n";
  return out;
}

using nlohmann::json;

json refuse(const std::string& stage, const std::string& text, json diagnostics) {
  return {{"ok", false}, {"stage", stage}, {"text", text}, {"diagnostics", std::move(diagnostics)}};
}

json refuse_whole(const std::string& stage, const std::string& name, const std::string& reason) {
  return refuse_at(stage, name, "", 0, reason);
}

json refuse_at(const std::string& stage, const std::string& name, const std::string& source, int line,
               const std::string& reason) {
  const json entry = {{"file", name},        {"line", line},      {"column", 0},
                      {"severity", "error"}, {"message", reason}, {"text", line_of(source, line)}};
  return refuse(stage, diagnostic_text(entry), json::array({entry}));
}

json refuse_admission(const Admission& admission, const std::string& name, const std::string& source) {
  json list = findings_json(admission, name, source);
  std::string text;
  for (const json& each : list) text += diagnostic_text(each);
  json refused = refuse("admission", text, list);
  if (admission.findings.empty()) {
    refused = refuse("tools", "the law could not be examined: " + admission.not_applied);
    refused["next"] = "the running law is unchanged; nothing is known against the law: swap again";
  }
  refused["gates"] = admission.gates_json();
  return refused;
}

json refuse_starved(const std::string& text) {
  json refused = refuse("compile", text);
  refused["starved"] = true;
  refused["next"] =
      "the running law is unchanged; nothing is known against the law: try again when the machine is less busy";
  return refused;
}

bool disk_is_full(const std::string& text) {
  return text.find("No space left") != std::string::npos || text.find("Disk quota exceeded") != std::string::npos;
}

bool memory_is_full(const std::string& text) {
  return text.find("out of memory") != std::string::npos || text.find("virtual memory exhausted") != std::string::npos;
}

}  // namespace lithe::lawd
