// SPDX-License-Identifier: Apache-2.0
#include "lawd/core/admission.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <utility>

namespace lithe::lawd {

using nlohmann::json;

std::string line_of(std::string_view source, int wanted) {
  for (int line = 1; !source.empty(); ++line) {
    const std::size_t end = std::min(source.find('\n'), source.size());
    if (line == wanted) return std::string(source.substr(0, std::min<std::size_t>(end, 200)));
    source.remove_prefix(std::min(end + 1, source.size()));
  }
  return "";
}

void Admission::refuse(std::string_view gate, std::string message, int line, int column) {
  const auto same = [&](const Finding& finding) { return finding.message == message && finding.line == line; };
  if (findings.size() >= kMaxFindings || std::any_of(findings.begin(), findings.end(), same)) return;
  findings.push_back({std::string(gate), std::move(message), line, column});
}

void Admission::apply(const char* gate, const std::function<std::string()>& rule) {
  const auto start = std::chrono::steady_clock::now();
  const std::size_t before = findings.size();
  const std::string not_applied_before = not_applied;
  std::string detail = rule();
  const double ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
  const bool ok = findings.size() == before && not_applied == not_applied_before;
  gates.push_back({gate, ok, ms, std::move(detail)});
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

}  // namespace lithe::lawd
